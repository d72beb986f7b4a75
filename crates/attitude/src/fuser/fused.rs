//! Output of a fuser: the fused attitude, the corrections of the step and the innovation.

use crate::{
    Complex, Vector3,
    accel::Inclination,
    course::CourseReference,
    scalars::{are_finite, scalars},
    stage::{Validate, attitude_validation_error},
    state::{Attitude, arg},
};

/// Output of a fuser at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fused {
    /// Attitude of the body at the end of the tick.
    pub attitude: Attitude,
    /// Body rate with the bias removed, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Gyro bias in body axes, rad/s; zero if the stage does not estimate it.
    pub bias_rad_s: Vector3<f64>,
    /// Angle between the up vectors of accelerometer and attitude, rad; 0 if there is no
    /// inclination.
    pub innovation_rad: f64,
    /// Standard deviation of the inclination, rad, derived from the stage's innovations.
    pub inclination_sd_rad: f64,
    /// Standard deviation of the heading, rad; π if unknown.
    pub heading_sd_rad: f64,
    /// Reference direction of the heading.
    pub reference: CourseReference,
    /// Corrections applied in this step.
    pub corrections: Corrections,
}

impl Validate for Fused {
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let (bias, rate) = (self.bias_rad_s, self.rate_rad_s);
        let sds = [self.innovation_rad, self.inclination_sd_rad, self.heading_sd_rad];
        let finite = are_finite([bias.x, bias.y, bias.z, rate.x, rate.y, rate.z, sds[0], sds[1], sds[2]]);
        attitude_validation_error(self.attitude)
            .or((!finite).then_some("a number that is not finite"))
            .or(sds.iter().any(|sd| *sd < 0.0).then_some("a standard deviation or innovation below zero"))
    }
}

/// Corrections applied in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Corrections {
    /// The tilt was corrected with the accelerometer.
    pub tilt: bool,
    /// The gyro bias was updated.
    pub bias: bool,
    /// The heading was corrected with the magnetic field.
    pub magnetic: bool,
    /// A satellite velocity was used.
    pub velocity: bool,
    /// The magnetic field is disturbed, so the heading follows the gyro.
    pub disturbed: bool,
    /// The body is at rest.
    pub rest: bool,
    /// The attitude was re-initialised: level, heading or both jump at this tick.
    pub aligned: bool,
}

scalars!(Fused:
    attitude, rate_rad_s, bias_rad_s, innovation_rad, inclination_sd_rad, heading_sd_rad, reference, corrections
);

scalars!(Corrections: tilt, bias, magnetic, velocity, disturbed, rest, aligned);

/// Returns the angle between the up vectors of accelerometer and attitude, rad.
pub fn innovation_rad(inclination: &Inclination, attitude: Attitude) -> f64 {
    let up = inclination.up.direction();
    arg(Complex::new(up.dot(&attitude.up.direction()), libm::sqrt(attitude.horizontal(up).norm_sqr())))
}
