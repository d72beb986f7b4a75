//! Simulated motions: what a body does, and what imperfect sensors on it would read.
//!
//! Input: a motion, the sensors' errors, a seed. Output: the true attitude and the readings at any time. Time: given, never read.
//! Failure: none. The same seed gives the same readings on every machine.
#![forbid(unsafe_code)]

use attitude::{GRAVITY_M_S2, Vector3, angles::Angles, state::Attitude, turn::Turn};
use rand_chacha::{ChaCha8Rng, rand_core::Rng, rand_core::SeedableRng};

/// How a body moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// The reference scenario of Matveev 2025: yaw 1 °/s, pitch 25° and roll 30° at 0.05 Hz.
    S1,
    /// A constant rate about an axis fixed in the body, rad/s, from level.
    Tumble(Vector3<f64>),
}

/// The truth at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Attitude.
    pub attitude: Attitude,
    /// Body rate, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force, m/s², body axes; the body turns in place.
    pub force_m_s2: Vector3<f64>,
}

impl Motion {
    /// The motions that have a name, with the name.
    pub const NAMES: [&'static str; 2] = ["s1", "tumble"];

    /// The motion of that name; `tumble` turns at 500 °/s about an axis oblique to all three.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "s1" => Some(Self::S1),
            "tumble" => Some(Self::Tumble(Vector3::new(1.0, -2.0, 3.0).normalize() * 500f64.to_radians())),
            _ => None,
        }
    }

    /// The truth at `t_s` seconds.
    pub fn at(self, t_s: f64) -> Truth {
        let (attitude, rate_rad_s) = match self {
            Self::S1 => s1(t_s),
            Self::Tumble(rate_rad_s) => {
                (Attitude::default().turned(Turn::of_rotation_vector(rate_rad_s * t_s)).attitude, rate_rad_s)
            }
        };
        Truth { attitude, rate_rad_s, force_m_s2: attitude.up.direction() * GRAVITY_M_S2 }
    }
}

/// ψ = 1°/s t, ϑ = 25° cos(2π 0.05 t), γ = 30° sin(2π 0.05 t); the body rates of a motion given in angles.
fn s1(t_s: f64) -> (Attitude, Vector3<f64>) {
    let (pitch_amplitude, roll_amplitude) = (25f64.to_radians(), 30f64.to_radians());
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
    (Attitude::of_angles(Angles { yaw_rad: yaw, pitch_rad: pitch, roll_rad: roll }), rate_rad_s)
}

/// What is wrong with the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Constant gyro bias on each axis, rad/s.
    pub gyro_bias_rad_s: f64,
    /// White noise of the accelerometer on each axis and sample, standard deviation, m/s².
    pub accel_noise_m_s2: f64,
}

impl Errors {
    /// Those of the reference scenario of Matveev 2025: 0.1 °/s, 0.01 g.
    pub const S1: Self =
        Self { gyro_bias_rad_s: 0.1 * core::f64::consts::PI / 180.0, accel_noise_m_s2: 0.01 * GRAVITY_M_S2 };
}

/// Readings of sensors that sample the motion at instants.
#[derive(Debug, Clone)]
pub struct Sensors {
    motion: Motion,
    errors: Errors,
    noise: ChaCha8Rng,
}

/// One reading of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Body rate at this instant, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force at this instant, m/s².
    pub force_m_s2: Vector3<f64>,
    /// What they should have read, and the attitude.
    pub truth: Truth,
}

impl Sensors {
    /// Sensors with these errors on a body in this motion.
    pub fn new(motion: Motion, errors: Errors, seed: u64) -> Self {
        Self { motion, errors, noise: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Reads the sensors at `t_s`; each call draws the next noise.
    pub fn read(&mut self, t_s: f64) -> Reading {
        let truth = self.motion.at(t_s);
        let noise = Vector3::new(self.normal(), self.normal(), self.normal());
        Reading {
            rate_rad_s: truth.rate_rad_s.add_scalar(self.errors.gyro_bias_rad_s),
            force_m_s2: truth.force_m_s2 + noise * self.errors.accel_noise_m_s2,
            truth,
        }
    }

    /// A normal deviate by Box and Muller, the same bits on every machine.
    fn normal(&mut self) -> f64 {
        let unit = |bits: u64| ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        let (first, second) = (unit(self.noise.next_u64()), unit(self.noise.next_u64()));
        libm::sqrt(-2.0 * libm::log(first)) * libm::cos(core::f64::consts::TAU * second)
    }
}
