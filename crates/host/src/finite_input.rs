//! What a program is given is finite, so no stage of the user's own has to look: what is not a number is missing, or zero where the slot has no
//! word for missing. A number that means infinity does so in a common state alone.

use attitude::{
    Vector3, course::CourseInput, fuser::FuserInput, gnss::Fix, gyro::RateSample, numbers::Numbers,
    stage::attitude_flaw, state::Attitude,
};

/// The input of a slot.
pub trait Given: Numbers + Default + Copy {
    /// The input with finite numbers only; the same where it has no others.
    fn finite(&self) -> Self;
}

/// A rate that is none is no turn: zero, over no time.
impl Given for RateSample {
    fn finite(&self) -> Self {
        let known = self.rate_rad_s.iter().all(|rate| rate.is_finite());
        let rate_rad_s = if known { self.rate_rad_s } else { Vector3::zeros() };
        Self { rate_rad_s, dt_s: if known { interval_s(self.dt_s) } else { 0.0 }, ..*self }
    }
}

/// A force that is none is zero, which has no direction.
impl Given for Vector3<f64> {
    fn finite(&self) -> Self {
        if self.iter().all(|force| force.is_finite()) { *self } else { Self::zeros() }
    }
}

impl Given for FuserInput {
    fn finite(&self) -> Self {
        *Self::finite(self, &mut None)
    }
}

impl Given for CourseInput {
    fn finite(&self) -> Self {
        let known = attitude_flaw(self.attitude).is_none();
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
