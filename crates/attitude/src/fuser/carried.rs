//! A gyro bias that another stage found, kept by one that does not estimate it for the stage that comes after it.

use super::Estimate;
use crate::{
    Vector3,
    stage::{Numbers, bias_flaw},
};

/// Random walk of the bias, rad/s/√s: 1 °/s in half a day, 0.1 °/s while a consumer MEMS gyro warms up for an hour.
const WALK_RAD_S: f64 = 3e-5;

/// What was handed over, and how old that is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Carried {
    bias_rad_s: Vector3<f64>,
    sd_rad_s: f64,
    age_s: f64,
    known: bool,
}

impl Default for Carried {
    fn default() -> Self {
        Self { bias_rad_s: Vector3::zeros(), sd_rad_s: 0.0, age_s: 0.0, known: false }
    }
}

impl Carried {
    /// Of a giver that knows a bias, or of one that does not.
    pub(super) fn of(common: &Estimate) -> Self {
        if common.bias_sd_rad_s.is_infinite() {
            return Self::default();
        }
        Self { bias_rad_s: common.bias_rad_s, sd_rad_s: common.bias_sd_rad_s, age_s: 0.0, known: true }
    }

    /// Time passes.
    pub(super) fn age(&mut self, dt_s: f64) {
        self.age_s += dt_s;
    }

    /// The bias and the standard deviation of each component, rad/s; infinite where nobody found one.
    pub(super) fn bias(&self) -> (Vector3<f64>, f64) {
        let sd_rad_s = libm::hypot(self.sd_rad_s, WALK_RAD_S * libm::sqrt(self.age_s));
        (self.bias_rad_s, if self.known { sd_rad_s } else { f64::INFINITY })
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let negative = (self.sd_rad_s < 0.0 || self.age_s < 0.0).then_some("an age or standard deviation below zero");
        bias_flaw(self.bias_rad_s).or(negative)
    }
}

impl Numbers for Carried {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias_rad_s.visit(visit);
        self.sd_rad_s.visit(visit);
        self.age_s.visit(visit);
        self.known.visit(visit);
    }
}
