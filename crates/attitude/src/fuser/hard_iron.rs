//! The field that the body itself adds to the magnetometer's, as one fuser hands it over to the next.

use crate::{Vector3, numbers::Numbers};

/// More than a magnetometer can bear, µT.
const MOST_UT: f64 = 1e4;

/// A hard iron, and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardIron {
    /// The field that is added, µT, body axes.
    pub field_ut: Vector3<f64>,
    /// Standard deviation of each of its components, µT; infinite where nobody estimated it.
    pub sd_ut: f64,
}

impl HardIron {
    /// Nobody estimated it.
    pub const UNKNOWN: Self = Self { field_ut: Vector3::new(0.0, 0.0, 0.0), sd_ut: f64::INFINITY };

    /// What is wrong with it.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        if !self.field_ut.iter().all(|x| x.abs() <= MOST_UT) {
            return Some("a hard iron beyond every magnet");
        }
        // The comparison also refuses what is not a number.
        let allowed = self.sd_ut >= 0.0;
        (!allowed).then_some("a standard deviation below zero")
    }
}

impl Default for HardIron {
    fn default() -> Self {
        Self::UNKNOWN
    }
}

impl Numbers for HardIron {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        // The numbers of a state are finite.
        let mut known = self.sd_ut.is_finite();
        let mut sd_ut = if known { self.sd_ut } else { 0.0 };
        known.visit(visit);
        self.field_ut.visit(visit);
        sd_ut.visit(visit);
        self.sd_ut = if known { sd_ut } else { f64::INFINITY };
    }
}
