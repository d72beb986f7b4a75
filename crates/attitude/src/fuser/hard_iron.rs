//! Magnetic field of the body itself (hard iron), as handed over from one fuser to another.

use crate::{Vector3, scalars::Scalars};

/// Largest hard iron that is accepted, µT. It is beyond the range of any magnetometer.
const MAX_FIELD_UT: f64 = 1e4;

/// Hard iron with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardIron {
    /// Magnetic field of the body in body axes, µT. The magnetometer measures the sum of this field
    /// and the external field.
    pub field_ut: Vector3<f64>,
    /// Standard deviation of each component, µT; infinite if unknown.
    pub sd_ut: f64,
}

impl HardIron {
    /// Unknown hard iron: zero, with an infinite standard deviation.
    pub const UNKNOWN: Self = Self { field_ut: Vector3::new(0.0, 0.0, 0.0), sd_ut: f64::INFINITY };

    /// Returns the reason why the value is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        if !self.field_ut.iter().all(|x| x.abs() <= MAX_FIELD_UT) {
            return Some("a hard iron above 10,000 µT");
        }
        // The comparison also rejects NaN.
        let valid_sd = self.sd_ut >= 0.0;
        (!valid_sd).then_some("a standard deviation below zero")
    }
}

impl Default for HardIron {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Scalars for HardIron {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        // All numbers of a state must be finite, so an infinite standard deviation is stored as a
        // flag.
        let mut known = self.sd_ut.is_finite();
        let mut sd_ut = if known { self.sd_ut } else { 0.0 };
        known.visit(visit);
        self.field_ut.visit(visit);
        sd_ut.visit(visit);
        self.sd_ut = if known { sd_ut } else { f64::INFINITY };
    }
}
