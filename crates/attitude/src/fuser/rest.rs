//! Rest: the gyro has not moved from its own mean for a while, sample by sample, nor the accelerometer, update by update.
//!
//! A steady turn about the vertical, slower than 2 °/s and with no other motion, looks the same and is taken for a bias: the
//! tilt does not suffer, heading does.

use crate::{Vector3, numbers::Numbers};

/// Time constant of the mean that samples are held against, s.
const MEAN_S: f64 = 0.5;
/// Largest distance of a rate from its mean at rest, rad/s: 2 °/s.
const RATE_SPREAD_RAD_S: f64 = 0.034_906_585;
/// Largest component of the mean rate that can be a bias, rad/s: 2 °/s.
const RATE_MEAN_RAD_S: f64 = 0.034_906_585;
/// Largest distance of a force from its mean at rest, m/s².
const FORCE_SPREAD_M_S2: f64 = 0.5;
/// A rate that no body has, rad/s.
const RATE_LIMIT_RAD_S: f64 = 1e6;
/// How long it must have been quiet, s.
const QUIET_S: f64 = 1.5;
/// Longest memory of the mean rate at rest, s.
const BIAS_MEMORY_S: f64 = 20.0;

/// Standard deviation of the bias found at rest, rad/s.
pub(super) const SD_REST_RAD_S: f64 = 8e-4;

/// Finds rest, and the mean rate during it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rest {
    rate_mean_rad_s: Vector3<f64>,
    force_mean_m_s2: Vector3<f64>,
    /// Since the last update.
    turned_rad: Vector3<f64>,
    moved: bool,
    quiet_s: f64,
    bias_rad_s: Vector3<f64>,
}

impl Default for Rest {
    fn default() -> Self {
        let zero = Vector3::zeros();
        Self {
            rate_mean_rad_s: zero,
            force_mean_m_s2: zero,
            turned_rad: zero,
            moved: true,
            quiet_s: 0.0,
            bias_rad_s: zero,
        }
    }
}

impl Rest {
    /// One sample.
    #[inline]
    pub(super) fn observe(&mut self, rate_rad_s: Vector3<f64>, dt_s: f64) {
        let off_rad_s = rate_rad_s - self.rate_mean_rad_s;
        self.turned_rad += rate_rad_s * dt_s;
        self.moved |= off_rad_s.norm_squared() >= RATE_SPREAD_RAD_S * RATE_SPREAD_RAD_S;
    }

    /// The samples of `interval_s` make an update; `force_m_s2` is the last of them.
    pub(super) fn update(&mut self, force_m_s2: Vector3<f64>, interval_s: f64) {
        let rate_rad_s = core::mem::take(&mut self.turned_rad) / interval_s;
        let off_m_s2 = force_m_s2 - self.force_mean_m_s2;
        self.moved |= off_m_s2.norm_squared() >= FORCE_SPREAD_M_S2 * FORCE_SPREAD_M_S2;
        if !(0.0..RATE_LIMIT_RAD_S * RATE_LIMIT_RAD_S).contains(&rate_rad_s.norm_squared()) {
            *self = Self::default();
            return;
        }
        let gain = (interval_s * (1.0 / MEAN_S)).min(1.0);
        self.rate_mean_rad_s += (rate_rad_s - self.rate_mean_rad_s) * gain;
        self.force_mean_m_s2 += off_m_s2 * gain;
        if core::mem::take(&mut self.moved) || self.rate_mean_rad_s.amax() >= RATE_MEAN_RAD_S {
            self.quiet_s = 0.0;
            return;
        }
        self.quiet_s += interval_s;
        self.bias_rad_s += (rate_rad_s - self.bias_rad_s) * (interval_s / self.quiet_s.min(BIAS_MEMORY_S)).min(1.0);
    }

    /// The sensors cannot be believed; rest starts anew.
    #[inline]
    pub(super) fn interrupt(&mut self) {
        self.moved = true;
        self.quiet_s = 0.0;
    }

    /// It has been quiet long enough.
    #[inline]
    pub(super) fn is_found(&self) -> bool {
        self.quiet_s >= QUIET_S
    }

    /// The mean rate since rest began, once it is found.
    pub(super) fn bias_rad_s(&self) -> Option<Vector3<f64>> {
        self.is_found().then_some(self.bias_rad_s)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.quiet_s < 0.0).then_some("a time of rest below zero")
    }
}

impl Numbers for Rest {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.rate_mean_rad_s.visit(visit);
        self.force_mean_m_s2.visit(visit);
        self.turned_rad.visit(visit);
        self.moved.visit(visit);
        self.quiet_s.visit(visit);
        self.bias_rad_s.visit(visit);
    }
}
