//! The standard deviation of an angle that a low-pass keeps, from its own innovations.

use core::f64::consts::PI;

use crate::numbers::Numbers;

/// Gyro bias that a stage without an estimate of it must reckon with, rad/s: a consumer MEMS gyro after its own calibration.
pub(super) const BIAS_SD_RAD_S: f64 = 0.003;
/// Memory of the innovation's mean square, s.
const MEMORY_S: f64 = 1.0;
/// Standard deviation of a first level, rad: a vehicle that accelerates by 1 m/s² at that moment.
const FIRST_RAD: f64 = 0.1;

/// How far an angle may be off.
///
/// A correction by the share g of a white innovation of standard deviation σ leaves σ² ← (1 − g)² σ² + g² <innovation²>; between
/// corrections a gyro bias adds to the angle itself. Innovations that are not white, as those of a vehicle that turns, are not told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    sd_rad: f64,
    innovation2_rad2: f64,
}

impl Spread {
    /// Nothing is known.
    pub(super) const UNKNOWN: Self = Self { sd_rad: PI, innovation2_rad2: 0.0 };
    /// Just set by one sample.
    pub(super) const FIRST: Self = Self { sd_rad: FIRST_RAD, innovation2_rad2: FIRST_RAD * FIRST_RAD };

    /// As another stage knew it.
    pub(super) fn of(sd_rad: f64) -> Self {
        let sd_rad = sd_rad.min(PI);
        Self { sd_rad, innovation2_rad2: sd_rad * sd_rad }
    }

    /// The gyro leads for a while.
    pub(super) fn drift(&mut self, bias_sd_rad_s: f64, dt_s: f64) {
        self.sd_rad = (self.sd_rad + bias_sd_rad_s * dt_s).min(PI);
    }

    /// A share of an innovation was taken off.
    pub(super) fn corrected(&mut self, innovation_rad: f64, gain: f64, dt_s: f64) {
        self.innovation2_rad2 += (innovation_rad * innovation_rad - self.innovation2_rad2) * (dt_s / (MEMORY_S + dt_s));
        let kept = (1.0 - gain) * self.sd_rad;
        self.sd_rad = libm::sqrt(kept * kept + gain * gain * self.innovation2_rad2).min(PI);
    }

    /// Root mean square of the innovations, rad.
    pub(super) fn innovation_rms_rad(&self) -> f64 {
        libm::sqrt(self.innovation2_rad2)
    }

    /// Standard deviation, rad; at most π.
    pub(super) fn sd_rad(&self) -> f64 {
        self.sd_rad
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.sd_rad < 0.0 || self.innovation2_rad2 < 0.0).then_some("a variance below zero")
    }
}

impl Numbers for Spread {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.sd_rad.visit(visit);
        self.innovation2_rad2.visit(visit);
    }
}
