//! Classical coning: a body axis describes a cone, and after each cycle the body is back in its
//! initial attitude.
//!
//! With the half angle α of the cone and the angular frequency Ω, the attitude is q(t) = (cos(α/2),
//! sin(α/2) cos Ωt, sin(α/2) sin Ωt, 0). The exact body rate is then ω = (−Ω sin α sin Ωt, Ω sin α
//! cos Ωt, −Ω (1 − cos α)).
//!
//! The axis of rotation changes continuously. An integrator that uses the integral of the rate over
//! an interval of length h as its rotation vector therefore drifts about the body axis ζ, at a rate
//! of approximately ½ Ω α² (1 − sin(Ωh)/(Ωh)).

use attitude::{Quaternion, Vector3, state::Attitude};

/// Parameters of the coning motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coning {
    /// Half angle α of the cone, rad.
    pub half_angle_rad: f64,
    /// Coning frequency Ω/2π, Hz.
    pub frequency_hz: f64,
}

impl Default for Coning {
    /// Returns a cone with a half angle of 5° and a frequency of 5 Hz. Sampled at 100 Hz and
    /// integrated without coning correction, it causes a drift of 0.11 °/s.
    fn default() -> Self {
        Self { half_angle_rad: 5f64.to_radians(), frequency_hz: 5.0 }
    }
}

impl Coning {
    fn frequency_rad_s(self) -> f64 {
        core::f64::consts::TAU * self.frequency_hz
    }

    /// Returns the attitude and the body rate in rad/s at `t_s`.
    pub(crate) fn at(self, t_s: f64) -> (Attitude, Vector3<f64>) {
        let frequency_rad_s = self.frequency_rad_s();
        let (sin, cos) = libm::sincos(frequency_rad_s * t_s);
        let (sin_half, cos_half) = libm::sincos(0.5 * self.half_angle_rad);
        let across_rad_s = frequency_rad_s * 2.0 * sin_half * cos_half;
        let rate_rad_s =
            Vector3::new(-across_rad_s * sin, across_rad_s * cos, -frequency_rad_s * 2.0 * sin_half * sin_half);
        (Attitude::from_quaternion(Quaternion::new(cos_half, sin_half * cos, sin_half * sin, 0.0)), rate_rad_s)
    }

    /// Returns the integral of the body rate in rad, up to a constant.
    ///
    /// The difference between its values at two times is the angle that an integrating gyro
    /// measures between these times.
    pub(crate) fn rotation_rad(self, t_s: f64) -> Vector3<f64> {
        let frequency_rad_s = self.frequency_rad_s();
        let (sin, cos) = libm::sincos(frequency_rad_s * t_s);
        let across = libm::sin(self.half_angle_rad);
        Vector3::new(across * cos, across * sin, -(1.0 - libm::cos(self.half_angle_rad)) * frequency_rad_s * t_s)
    }
}
