//! The fuser stage `vqf`.

use super::{Corrections, Estimate, Fused, FuserInput};
use crate::{
    Vector3,
    course::Reference,
    stage::{Numbers, RestoreError, Stage, attitude_flaw},
    state::Attitude,
};
use core::f64::consts::PI;

/// The fuser stage `vqf`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Vqf {
    attitude: Attitude,
    started: bool,
}

impl Vqf {
    pub(super) fn realign(&mut self) {
        self.started = false;
    }
}

impl Stage for Vqf {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "vqf"
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        if let Some(motion) = &input.motion {
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        if let (false, Some(inclination)) = (self.started, &input.inclination) {
            self.attitude = self.attitude.realigned(inclination.up).attitude;
            self.started = true;
            corrections.aligned = true;
        }
        Fused {
            attitude: self.attitude,
            rate_rad_s: input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s),
            bias_rad_s: Vector3::zeros(),
            innovation_rad: 0.0,
            inclination_sd_rad: 0.0,
            heading_sd_rad: PI,
            reference: Reference::Arbitrary,
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.attitude.visit(visit);
        self.started.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(self.attitude)
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude,
            reference: Reference::Arbitrary,
            bias_rad_s: Vector3::zeros(),
            inclination_sd_rad: 0.0,
            heading_sd_rad: PI,
            bias_sd_rad_s: f64::INFINITY,
        }
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.attitude = common.attitude;
        self.started = true;
        Ok(())
    }
}
