//! The estimate that every fuser can hand over to every other, and how fast its bias ages.

use core::f64::consts::PI;

use super::{gyro_scale::GyroScale, hard_iron::HardIron, leaky_velocity::LeakyVelocity};
use crate::{
    Complex, Vector3,
    course::Reference,
    numbers::Numbers,
    point::{Chart, Point},
    stage::{RestoreError, bias_flaw},
    state::Attitude,
};

/// Random walk of a gyro's bias that nobody follows, rad/s/√s: 0.1 °/s while a consumer MEMS gyro warms up for an hour.
pub const BIAS_WALK_RAD_S: f64 = 3e-5;

/// What every fuser can hand over to every other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The attitude.
    pub attitude: Attitude,
    /// What its heading is counted from.
    pub reference: Reference,
    /// Gyro bias, rad/s, body axes; that of an earlier giver where this one does not estimate it.
    pub bias_rad_s: Vector3<f64>,
    /// Standard deviation of the inclination, rad.
    pub inclination_sd_rad: f64,
    /// Standard deviation of the heading, rad; π where nothing is known.
    pub heading_sd_rad: f64,
    /// Standard deviation of each component of the bias, rad/s; infinite where nobody estimated it.
    pub bias_sd_rad_s: f64,
    /// Error of the gyro's scale; that of an earlier giver where this one does not estimate it.
    pub gyro_scale: GyroScale,
    /// Hard iron of the magnetometer; that of an earlier giver where this one does not estimate it.
    pub hard_iron: HardIron,
    /// The velocity by which this one's level leans.
    pub leaky_velocity: LeakyVelocity,
}

impl Default for Estimate {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Estimate {
    /// Nothing is known: the body may be anywhere, the sensors may be anything.
    pub const UNKNOWN: Self = Self {
        attitude: Attitude { up: Point { w: Complex::new(0.0, 0.0), chart: Chart::Upright }, z_rad: 0.0 },
        reference: Reference::Arbitrary,
        bias_rad_s: Vector3::new(0.0, 0.0, 0.0),
        inclination_sd_rad: PI,
        heading_sd_rad: PI,
        bias_sd_rad_s: f64::INFINITY,
        gyro_scale: GyroScale::UNKNOWN,
        hard_iron: HardIron::UNKNOWN,
        leaky_velocity: LeakyVelocity::UNKNOWN,
    };

    /// Refuses what is not an estimate.
    pub fn checked(&self) -> Result<(), RestoreError> {
        self.attitude.checked()?;
        if let Some(index) = self.bias_rad_s.iter().position(|x| !x.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        if let Some(flaw) = bias_flaw(self.bias_rad_s) {
            return Err(RestoreError::Flaw { flaw });
        }
        let sds = [self.inclination_sd_rad, self.heading_sd_rad, self.bias_sd_rad_s];
        if !sds.iter().all(|sd| *sd >= 0.0) {
            return Err(RestoreError::Flaw { flaw: "a standard deviation below zero" });
        }
        let flaw = self.gyro_scale.flaw().or_else(|| self.hard_iron.flaw()).or_else(|| self.leaky_velocity.flaw());
        flaw.map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))
    }
}

/// A standard deviation of what nobody estimated is infinite here, too.
impl Numbers for Estimate {
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
