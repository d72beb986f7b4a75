//! A level that was taken over from another stage while the body was under way.
//!
//! The loop begins with the velocity of the loop before it, or without one. By the difference from the body's it leans, for as long
//! as it remembers, off a level that was right. What leans it is known, and so is where the level would be without: the difference shows in the tilt that the
//! filter of the bias finds, is estimated from it and taken back. The less is known of the level that was taken over, the less is taken.

use super::{
    level::{Error, Response},
    time_constants::T2_S,
};
use crate::{Complex, GRAVITY_M_S2, numbers::Numbers};

/// What the loop is off by in a movement, rad: 1°.
const LOOP_SD_RAD: f64 = 0.017_453_293;

/// Estimates what the loop's first velocity was off by.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct InitialVelocity {
    /// Tilt and velocity of the loop for a unit of it.
    share: [f64; 2],
    variance_s2: f64,
}

impl InitialVelocity {
    /// A level was just taken over, with a velocity that is known so well.
    pub(super) fn begun(sd_m_s: f64) -> Self {
        let sd_s = sd_m_s / GRAVITY_M_S2;
        Self { share: [0.0, 1.0], variance_s2: sd_s * sd_s }
    }

    /// After `interval_s` the loop is off by `tilt_rad`, as the filter has it with this variance. What is to be taken back.
    pub(super) fn observe(&mut self, tilt_rad: Complex<f64>, tilt_variance_rad2: f64, interval_s: f64) -> Error {
        let [tilt, velocity] = self.share;
        self.share = Response::over(interval_s).after(tilt, velocity);
        // What the loop is off by otherwise stays alike for its time constant.
        let noise_rad2 = (LOOP_SD_RAD * LOOP_SD_RAD + tilt_variance_rad2) * (T2_S / interval_s).max(1.0);
        let [tilt, velocity] = self.share;
        let gain = self.variance_s2 * tilt / (tilt * tilt * self.variance_s2 + noise_rad2);
        self.variance_s2 *= (1.0 - gain * tilt).max(0.0);
        let found_s = tilt_rad * gain;
        Error { tilt: found_s * tilt, velocity: found_s * velocity }
    }

    /// Standard deviation of what is left in the loop's velocity, m/s.
    pub(super) fn left_sd_m_s(&self) -> f64 {
        libm::sqrt(self.variance_s2) * libm::fabs(self.share[1]) * GRAVITY_M_S2
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.variance_s2 < 0.0).then_some("a variance below zero")
    }
}

impl Numbers for InitialVelocity {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.share.iter_mut().for_each(&mut *visit);
        self.variance_s2.visit(visit);
    }
}
