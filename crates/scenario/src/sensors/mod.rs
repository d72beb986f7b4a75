//! Imperfect sensors on a body.
//!
//! Input: a motion, errors, a seed, and times that do not go back. Output: what the sensors read then, and the truth. Failure: none.

pub mod errors;
mod receiver;

use attitude::{Vector3, gnss::Fix};

use crate::{
    Errors, Motion, Truth,
    motion::Body,
    noise::{Noise, Use},
};
use receiver::Fixes;

/// Rate at which the earth turns, rad/s (WGS 84).
const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// Readings of sensors on a body in motion.
#[derive(Debug, Clone)]
pub struct Sensors {
    body: Body,
    errors: Errors,
    signs: Signs,
    accel: Noise,
    gyro: Noise,
    field: Noise,
    fixes: Option<Fixes>,
    integrating: bool,
    before_s: Option<f64>,
}

/// The signs of the constant errors.
#[derive(Debug, Clone, Copy)]
struct Signs {
    gyro_bias: Vector3<f64>,
    gyro_ramp: Vector3<f64>,
    gyro_scale: Vector3<f64>,
    accel_bias: Vector3<f64>,
}

/// One reading of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Body rate, rad/s: at this instant, or the mean since the reading before where the sensors integrate.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force at this instant, m/s².
    pub force_m_s2: Vector3<f64>,
    /// The magnetic field at this instant, µT, body axes, where there is a magnetometer.
    pub field_ut: Option<Vector3<f64>>,
    /// The fix that arrived since the reading before.
    pub fix: Option<Fix>,
    /// What they should have read, and the attitude.
    pub truth: Truth,
}

impl Sensors {
    /// Sensors with these errors on a body in this motion; the gyro samples the rate at instants.
    pub fn new(motion: Motion, errors: Errors, seed: u64) -> Self {
        let mut constants = Noise::new(seed, Use::Constants);
        let mut signs = || if errors.random_signs { constants.signs() } else { Vector3::repeat(1.0) };
        let signs = Signs { gyro_bias: signs(), accel_bias: signs(), gyro_scale: signs(), gyro_ramp: signs() };
        Self {
            body: Body::new(motion),
            errors,
            signs,
            accel: Noise::new(seed, Use::Accel),
            gyro: Noise::new(seed, Use::Gyro),
            field: Noise::new(seed, Use::Field),
            fixes: errors.receiver.map(|receiver| Fixes::new(receiver, seed)),
            integrating: false,
            before_s: None,
        }
    }

    /// The same sensors with a gyro that reads the mean rate since the reading before.
    #[must_use]
    pub fn integrating(self) -> Self {
        Self { integrating: true, ..self }
    }

    /// The gyro bias at `t_s`, rad/s, body axes.
    pub fn gyro_bias_rad_s(&self, t_s: f64) -> Vector3<f64> {
        self.signs.gyro_bias * self.errors.gyro_bias_rad_s
            + self.signs.gyro_ramp * (self.errors.gyro_bias_ramp_rad_s2 * t_s)
    }

    /// The accelerometer bias, m/s², body axes.
    pub fn accel_bias_m_s2(&self) -> Vector3<f64> {
        self.signs.accel_bias * self.errors.accel_bias_m_s2
    }

    /// Reads the sensors at `t_s`; each call draws the next noise.
    pub fn read(&mut self, t_s: f64) -> Reading {
        let truth = self.body.at(t_s);
        let matrix = truth.attitude.matrix();
        let noise = if self.errors.exact_start && self.before_s.is_none() { 0.0 } else { 1.0 };
        let mut rate_rad_s = match self.before_s.filter(|_| self.integrating) {
            Some(before_s) => self.body.mean_rate_rad_s(before_s, t_s),
            None => truth.rate_rad_s,
        };
        self.before_s = Some(t_s);
        if let Some(latitude_rad) = self.errors.earth_latitude_rad {
            let (sin, cos) = libm::sincos(latitude_rad);
            rate_rad_s += matrix * Vector3::new(0.0, cos, sin) * EARTH_RATE_RAD_S;
        }
        rate_rad_s += rate_rad_s.component_mul(&self.signs.gyro_scale) * self.errors.gyro_scale;
        rate_rad_s += self.gyro_bias_rad_s(t_s) + self.gyro.normals() * self.errors.gyro_noise_rad_s;
        let accel_noise_m_s2 = self.accel.normals() * (noise * self.errors.accel_noise_m_s2);
        let field_noise = self.field.normals() * noise;
        Reading {
            rate_rad_s,
            force_m_s2: truth.force_m_s2 + self.accel_bias_m_s2() + accel_noise_m_s2,
            field_ut: self.errors.field.map(|of| matrix * of.reference_ut + field_noise * of.noise_ut),
            fix: self.fixes.as_mut().and_then(|fixes| fixes.arrived(&mut self.body, t_s)),
            truth,
        }
    }
}
