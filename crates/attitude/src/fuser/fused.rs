//! The output of a fuser: the fused attitude, the corrections of the step, the innovation.

use crate::{
    Complex, Vector3,
    accel::Inclination,
    course::Reference,
    numbers::Numbers,
    stage::{Sound, attitude_flaw},
    state::{Attitude, arg},
};

/// What a fuser knows after a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fused {
    /// The attitude.
    pub attitude: Attitude,
    /// Body rate less the bias, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Gyro bias, rad/s, body axes; zero where the stage does not estimate it.
    pub bias_rad_s: Vector3<f64>,
    /// Angle between the accelerometer's up and the attitude's, rad; 0 without an inclination.
    pub innovation_rad: f64,
    /// Standard deviation of the inclination, rad, as far as the stage's own innovations tell it.
    pub inclination_sd_rad: f64,
    /// Standard deviation of the heading, rad; π where nothing is known.
    pub heading_sd_rad: f64,
    /// What the heading is counted from.
    pub reference: Reference,
    /// Which corrections were used.
    pub corrections: Corrections,
}

impl Sound for Fused {
    fn flaw(&self) -> Option<&'static str> {
        let sds = [self.innovation_rad, self.inclination_sd_rad, self.heading_sd_rad];
        let finite = self.bias_rad_s.iter().chain(&self.rate_rad_s).chain(&sds).all(|number| number.is_finite());
        attitude_flaw(self.attitude)
            .or((!finite).then_some("a number that is not finite"))
            .or(sds.iter().any(|sd| *sd < 0.0).then_some("a standard deviation or innovation below zero"))
    }
}

/// Which corrections a step used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Corrections {
    /// The tilt moved towards the accelerometer's.
    pub tilt: bool,
    /// The gyro bias was updated.
    pub bias: bool,
    /// The heading moved towards the magnetic field's.
    pub magnetic: bool,
    /// A satellite velocity was used.
    pub velocity: bool,
    /// The magnetic field is not that of the place; heading follows the gyro.
    pub disturbed: bool,
    /// The body was found to be at rest.
    pub rest: bool,
    /// The attitude was set anew: its level, its heading or both jump here.
    pub aligned: bool,
}

impl Numbers for Fused {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self {
            attitude,
            rate_rad_s,
            bias_rad_s,
            innovation_rad,
            inclination_sd_rad,
            heading_sd_rad,
            reference,
            corrections,
        } = self;
        attitude.visit(visit);
        rate_rad_s.visit(visit);
        bias_rad_s.visit(visit);
        [innovation_rad, inclination_sd_rad, heading_sd_rad].into_iter().for_each(|number| number.visit(visit));
        reference.visit(visit);
        corrections.visit(visit);
    }
}

impl Numbers for Corrections {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { tilt, bias, magnetic, velocity, disturbed, rest, aligned } = self;
        [tilt, bias, magnetic, velocity, disturbed, rest, aligned].into_iter().for_each(|used| used.visit(visit));
    }
}

/// Angle between the accelerometer's up and the attitude's, rad.
pub fn innovation_rad(inclination: &Inclination, attitude: Attitude) -> f64 {
    let up = inclination.up.direction();
    arg(Complex::new(up.dot(&attitude.up.direction()), libm::sqrt(attitude.horizontal(up).norm_sqr())))
}
