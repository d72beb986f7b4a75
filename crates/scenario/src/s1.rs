//! Reference scenario of Matveev 2025: yaw ψ = (1 °/s) t, pitch ϑ = 25° cos(2π 0.05 t), roll γ =
//! 30° sin(2π 0.05 t).

use attitude::{Vector3, angles::Angles, state::Attitude};

const DEGREE_RAD: f64 = core::f64::consts::PI / 180.0;

/// Amplitudes of an oscillation in pitch and roll.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Swing {
    /// Amplitude of the pitch, rad.
    pub pitch_amplitude_rad: f64,
    /// Amplitude of the roll, rad.
    pub roll_amplitude_rad: f64,
}

impl Swing {
    /// Amplitudes of Matveev 2025: pitch 25°, roll 30°.
    pub const S1: Self = Self { pitch_amplitude_rad: 25.0 * DEGREE_RAD, roll_amplitude_rad: 30.0 * DEGREE_RAD };

    /// Returns the oscillation scaled to a roll amplitude in rad, with the pitch in proportion.
    #[must_use]
    pub fn with_roll_amplitude(self, roll_amplitude_rad: f64) -> Self {
        let pitch_amplitude_rad = self.pitch_amplitude_rad * roll_amplitude_rad / self.roll_amplitude_rad;
        Self { pitch_amplitude_rad, roll_amplitude_rad }
    }
}

/// Returns the attitude and the body rate in rad/s at `t_s`. The rate follows from the derivatives
/// of the angles.
pub(crate) fn at(swing: Swing, t_s: f64) -> (Attitude, Vector3<f64>) {
    let Swing { pitch_amplitude_rad: pitch_amplitude, roll_amplitude_rad: roll_amplitude } = swing;
    let frequency_rad_s = core::f64::consts::TAU * 0.05;
    let (sin, cos) = libm::sincos(frequency_rad_s * t_s);
    let (yaw_dot, pitch_dot, roll_dot) =
        (1f64.to_radians(), -pitch_amplitude * frequency_rad_s * sin, roll_amplitude * frequency_rad_s * cos);
    let (yaw, pitch, roll) = (yaw_dot * t_s, pitch_amplitude * cos, roll_amplitude * sin);
    let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(pitch), libm::sincos(roll));
    let rate_rad_s = Vector3::new(
        pitch_dot * cos_roll - yaw_dot * cos_pitch * sin_roll,
        roll_dot + yaw_dot * sin_pitch,
        yaw_dot * cos_pitch * cos_roll + pitch_dot * sin_roll,
    );
    (Attitude::from_angles(Angles { yaw_rad: yaw, pitch_rad: pitch, roll_rad: roll }), rate_rad_s)
}
