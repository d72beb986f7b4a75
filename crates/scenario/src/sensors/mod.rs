//! Simulates imperfect sensors on a moving body.
//!
//! Input: a motion, sensor errors, a seed, and non-decreasing times.
//!
//! Output: the sensor readings and the true state at each time.

pub mod errors;
mod receiver;

use attitude::{EARTH_RATE_RAD_S, Vector3, gnss::Fix};

use crate::{
    Motion, SensorErrors, Truth,
    motion::Body,
    random::{RandomStream, StreamId},
};
use receiver::SimulatedReceiver;

/// Simulated sensors on a moving body.
#[derive(Debug, Clone)]
pub struct Sensors {
    body: Body,
    errors: SensorErrors,
    signs: Signs,
    accel_noise: RandomStream,
    gyro_noise: RandomStream,
    field_noise: RandomStream,
    receiver: Option<SimulatedReceiver>,
    is_integrating: bool,
    previous_s: Option<f64>,
}

/// Signs of the constant errors on each axis.
#[derive(Debug, Clone, Copy)]
struct Signs {
    gyro_bias: Vector3<f64>,
    gyro_ramp: Vector3<f64>,
    gyro_scale: Vector3<f64>,
    accel_bias: Vector3<f64>,
}

/// One reading of all sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Body rate, rad/s, body axes: the instantaneous rate or, for an integrating gyro, the mean
    /// since the previous reading.
    pub rate_rad_s: Vector3<f64>,
    /// Instantaneous specific force, m/s², body axes.
    pub force_m_s2: Vector3<f64>,
    /// Instantaneous magnetic field, µT, body axes; `None` without a magnetometer.
    pub field_ut: Option<Vector3<f64>>,
    /// Newest fix that arrived since the previous reading.
    pub fix: Option<Fix>,
    /// True state at the time of the reading.
    pub truth: Truth,
}

impl Sensors {
    /// Creates sensors on a body with the given motion. The gyro samples the instantaneous rate.
    pub fn new(motion: Motion, errors: SensorErrors, seed: u64) -> Self {
        let mut constants = RandomStream::new(seed, StreamId::Constants);
        let mut signs = || if errors.random_signs { constants.signs() } else { Vector3::repeat(1.0) };
        let signs = Signs { gyro_bias: signs(), accel_bias: signs(), gyro_scale: signs(), gyro_ramp: signs() };
        Self {
            body: Body::new(motion),
            errors,
            signs,
            accel_noise: RandomStream::new(seed, StreamId::Accel),
            gyro_noise: RandomStream::new(seed, StreamId::Gyro),
            field_noise: RandomStream::new(seed, StreamId::Field),
            receiver: errors.receiver.map(|receiver| SimulatedReceiver::new(receiver, seed)),
            is_integrating: false,
            previous_s: None,
        }
    }

    /// Returns the sensors with a gyro that reads the mean rate since the previous reading.
    #[must_use]
    pub fn with_integrating_gyro(self) -> Self {
        Self { is_integrating: true, ..self }
    }

    /// Returns the gyro bias at `t_s`, rad/s, body axes.
    pub fn gyro_bias_rad_s(&self, t_s: f64) -> Vector3<f64> {
        self.signs.gyro_bias * self.errors.gyro_bias_rad_s
            + self.signs.gyro_ramp * (self.errors.gyro_bias_ramp_rad_s2 * t_s)
    }

    /// Returns the accelerometer bias, m/s², body axes.
    pub fn accel_bias_m_s2(&self) -> Vector3<f64> {
        self.signs.accel_bias * self.errors.accel_bias_m_s2
    }

    /// Reads the sensors at `t_s`. Each call draws new noise.
    pub fn read(&mut self, t_s: f64) -> Reading {
        let truth = self.body.at(t_s);
        let matrix = truth.attitude.matrix();
        let noise = if self.errors.exact_start && self.previous_s.is_none() { 0.0 } else { 1.0 };
        let mut rate_rad_s = match self.previous_s.filter(|_| self.is_integrating) {
            Some(previous_s) => self.body.mean_rate_rad_s(previous_s, t_s),
            None => truth.rate_rad_s,
        };
        self.previous_s = Some(t_s);
        if let Some(latitude_rad) = self.errors.earth_latitude_rad {
            let (sin, cos) = libm::sincos(latitude_rad);
            rate_rad_s += matrix * Vector3::new(0.0, cos, sin) * EARTH_RATE_RAD_S;
        }
        rate_rad_s += rate_rad_s.component_mul(&self.signs.gyro_scale) * self.errors.gyro_scale;
        rate_rad_s += self.gyro_bias_rad_s(t_s) + self.gyro_noise.normals() * self.errors.gyro_noise_rad_s;
        let accel_noise_m_s2 = self.accel_noise.normals() * (noise * self.errors.accel_noise_m_s2);
        let field_noise = self.field_noise.normals() * noise;
        Reading {
            rate_rad_s,
            force_m_s2: truth.force_m_s2 + self.accel_bias_m_s2() + accel_noise_m_s2,
            field_ut: self.errors.magnetometer.map(|m| matrix * m.reference_ut + field_noise * m.noise_ut),
            fix: self.receiver.as_mut().and_then(|receiver| receiver.poll(&mut self.body, t_s)),
            truth,
        }
    }
}
