//! Estimate that every fuser can hand over to every other.

use core::f64::consts::PI;

use super::{gyro_scale::GyroScale, hard_iron::HardIron, leaky_velocity::LeakyVelocity};
use crate::{
    Complex, Vector3,
    course::CourseReference,
    point::{Chart, Point},
    scalars::Scalars,
    stage::{RestoreError, bias_validation_error},
    state::Attitude,
};

/// Random walk of a gyro bias that is not being estimated, rad/s/√s.
///
/// The value corresponds to a drift of 0.1 °/s while a consumer MEMS gyro warms up for an hour.
pub const BIAS_WALK_RAD_S: f64 = 3e-5;

/// State that one fuser hands over to another.
///
/// A fuser that does not estimate a sensor error passes on the value it received.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Attitude of the body at the last tick.
    pub attitude: Attitude,
    /// Reference direction of the heading.
    pub reference: CourseReference,
    /// Gyro bias in body axes, rad/s.
    pub bias_rad_s: Vector3<f64>,
    /// Standard deviation of the inclination, rad.
    pub inclination_sd_rad: f64,
    /// Standard deviation of the heading, rad; π if unknown.
    pub heading_sd_rad: f64,
    /// Standard deviation of each component of the bias, rad/s; infinite if unknown.
    pub bias_sd_rad_s: f64,
    /// Scale error of the gyro.
    pub gyro_scale: GyroScale,
    /// Hard iron of the magnetometer.
    pub hard_iron: HardIron,
    /// Leaky velocity of the levelling loop.
    pub leaky_velocity: LeakyVelocity,
}

impl Default for Estimate {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Estimate {
    /// Estimate in which every quantity is unknown.
    pub const UNKNOWN: Self = Self {
        attitude: Attitude { up: Point { w: Complex::new(0.0, 0.0), chart: Chart::Upright }, z_rad: 0.0 },
        reference: CourseReference::Arbitrary,
        bias_rad_s: Vector3::new(0.0, 0.0, 0.0),
        inclination_sd_rad: PI,
        heading_sd_rad: PI,
        bias_sd_rad_s: f64::INFINITY,
        gyro_scale: GyroScale::UNKNOWN,
        hard_iron: HardIron::UNKNOWN,
        leaky_velocity: LeakyVelocity::UNKNOWN,
    };

    /// Checks that the numbers form a valid estimate.
    ///
    /// # Errors
    ///
    /// Returns [`RestoreError::NotFinite`] for a non-finite number and [`RestoreError::Invalid`]
    /// for a value outside its range.
    pub fn validate(&self) -> Result<(), RestoreError> {
        self.attitude.validate()?;
        if let Some(index) = self.bias_rad_s.iter().position(|x| !x.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        if let Some(reason) = bias_validation_error(self.bias_rad_s) {
            return Err(RestoreError::Invalid { reason });
        }
        let sds = [self.inclination_sd_rad, self.heading_sd_rad, self.bias_sd_rad_s];
        if !sds.iter().all(|sd| *sd >= 0.0) {
            return Err(RestoreError::Invalid { reason: "a standard deviation below zero" });
        }
        let reason = self
            .gyro_scale
            .validation_error()
            .or_else(|| self.hard_iron.validation_error())
            .or_else(|| self.leaky_velocity.validation_error());
        reason.map_or(Ok(()), |reason| Err(RestoreError::Invalid { reason }))
    }
}

/// Infinite standard deviations, which mean "unknown", are visited unchanged.
impl Scalars for Estimate {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self {
            attitude,
            reference,
            bias_rad_s,
            inclination_sd_rad,
            heading_sd_rad,
            bias_sd_rad_s,
            gyro_scale: GyroScale { error, sd },
            hard_iron: HardIron { field_ut, sd_ut },
            leaky_velocity,
        } = self;
        attitude.visit(visit);
        reference.visit(visit);
        bias_rad_s.visit(visit);
        [inclination_sd_rad, heading_sd_rad, bias_sd_rad_s].into_iter().for_each(|number| number.visit(visit));
        error.visit(visit);
        sd.visit(visit);
        field_ut.visit(visit);
        sd_ut.visit(visit);
        leaky_velocity.visit(visit);
    }
}
