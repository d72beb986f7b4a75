//! Conversion of stage inputs to finite numbers, so that external stages need no checks.
//!
//! A value that is not finite is treated as missing, or becomes zero if the slot's input cannot
//! represent a missing value. Infinite values, which mean "unknown", may remain only in the state
//! that is common to all stages of a slot.

use attitude::{
    Vector3, course::CourseInput, fuser::FuserInput, gnss::Fix, gyro::RateSample, scalars::Scalars,
    stage::attitude_validation_error, state::Attitude,
};

/// Input of a slot that can be converted to finite numbers.
pub trait FiniteInput: Scalars + Default + Copy {
    /// Returns the input with finite numbers only. Finite values are unchanged.
    fn finite(&self) -> Self;
}

/// An invalid rate becomes zero, with an interval of zero, so that there is no rotation.
impl FiniteInput for RateSample {
    fn finite(&self) -> Self {
        let known = self.rate_rad_s.iter().all(|rate| rate.is_finite());
        let rate_rad_s = if known { self.rate_rad_s } else { Vector3::zeros() };
        Self { rate_rad_s, dt_s: if known { interval_s(self.dt_s) } else { 0.0 }, ..*self }
    }
}

/// An invalid force becomes zero, which has no direction.
impl FiniteInput for Vector3<f64> {
    fn finite(&self) -> Self {
        if self.iter().all(|force| force.is_finite()) { *self } else { Self::zeros() }
    }
}

impl FiniteInput for FuserInput {
    fn finite(&self) -> Self {
        *Self::sanitized(self, &mut None)
    }
}

impl FiniteInput for CourseInput {
    fn finite(&self) -> Self {
        let known = attitude_validation_error(self.attitude).is_none();
        let sd_known = self.heading_sd_rad.is_finite();
        Self {
            attitude: if known { self.attitude } else { Attitude::default() },
            heading_sd_rad: if sd_known { self.heading_sd_rad } else { std::f64::consts::PI },
            fix: self.fix.and_then(Fix::finite),
            dt_s: interval_s(self.dt_s),
            ..*self
        }
    }
}

fn interval_s(dt_s: f64) -> f64 {
    if dt_s >= 0.0 && dt_s.is_finite() { dt_s } else { 0.0 }
}
