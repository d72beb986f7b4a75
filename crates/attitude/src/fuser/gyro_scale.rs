//! Scale error of the gyro, as handed over from one fuser to another.

use crate::{Vector3, scalars::Scalars};

/// Largest scale error that is accepted. No usable gyro exceeds it.
const MAX_ERROR: f64 = 0.1;

/// Scale error of each gyro axis with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyroScale {
    /// Relative scale error of each body axis, positive if the gyro reads too high.
    pub error: Vector3<f64>,
    /// Standard deviation of each component; infinite if unknown.
    pub sd: Vector3<f64>,
}

impl GyroScale {
    /// Unknown scale error: zero, with an infinite standard deviation.
    pub const UNKNOWN: Self =
        Self { error: Vector3::new(0.0, 0.0, 0.0), sd: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY) };

    /// Returns the reason why the value is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        if !self.error.iter().all(|error| error.abs() <= MAX_ERROR) {
            return Some("a gyro scale error above 0.1");
        }
        // The comparison also rejects NaN.
        let valid_sd = self.sd.iter().all(|sd| *sd >= 0.0);
        (!valid_sd).then_some("a standard deviation below zero")
    }
}

impl Default for GyroScale {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Scalars for GyroScale {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        // All numbers of a state must be finite, so an infinite standard deviation is stored as a
        // flag.
        let mut known = self.sd.iter().all(|sd| sd.is_finite());
        let mut sd = if known { self.sd } else { Vector3::zeros() };
        known.visit(visit);
        self.error.visit(visit);
        sd.visit(visit);
        self.sd = if known { sd } else { Self::UNKNOWN.sd };
    }
}
