//! The error of the gyro's scale, as one fuser hands it over to the next.

use crate::{Vector3, numbers::Numbers};

/// More than any gyro has.
const MOST: f64 = 0.1;

/// The errors of the scale of the axes, and how well they are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyroScale {
    /// By which part of itself the rate about each body axis is read too large.
    pub error: Vector3<f64>,
    /// Standard deviation of each; infinite where nobody estimated it.
    pub sd: Vector3<f64>,
}

impl GyroScale {
    /// Nobody estimated it.
    pub const UNKNOWN: Self =
        Self { error: Vector3::new(0.0, 0.0, 0.0), sd: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY) };

    /// What is wrong with it.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        if !self.error.iter().all(|error| error.abs() <= MOST) {
            return Some("a scale of the gyro that no gyro has");
        }
        // The comparison also refuses what is not a number.
        let allowed = self.sd.iter().all(|sd| *sd >= 0.0);
        (!allowed).then_some("a standard deviation below zero")
    }
}

impl Default for GyroScale {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Numbers for GyroScale {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        // The numbers of a state are finite.
        let mut known = self.sd.iter().all(|sd| sd.is_finite());
        let mut sd = if known { self.sd } else { Vector3::zeros() };
        known.visit(visit);
        self.error.visit(visit);
        sd.visit(visit);
        self.sd = if known { sd } else { Self::UNKNOWN.sd };
    }
}
