//! Rest detector: gyro and accelerometer have stayed close to their own means for a while.
//!
//! The gyro is checked at each sample, the accelerometer at each update. A steady rotation about
//! the vertical, slower than 2 °/s and without other motion, looks like rest, and its rate is
//! mistaken for a bias. This affects the heading, but not the tilt.

use crate::{Vector3, scalars::scalars};

/// Time constant of the means that samples are compared with, s.
const MEAN_TIME_CONSTANT_S: f64 = 0.5;
/// Largest deviation of a rate from its mean at rest, rad/s (2 °/s).
const MAX_RATE_DEVIATION_RAD_S: f64 = 0.034_906_585;
/// Largest component of the mean rate that is accepted as a bias, rad/s (2 °/s).
const MAX_MEAN_RATE_RAD_S: f64 = 0.034_906_585;
/// Largest deviation of a force from its mean at rest, m/s².
const MAX_FORCE_DEVIATION_M_S2: f64 = 0.5;
/// Largest plausible rate, rad/s. A larger mean rate resets the detector.
const MAX_RATE_RAD_S: f64 = 1e6;
/// Time without movement after which rest is detected, s.
const MIN_QUIET_S: f64 = 1.5;
/// Longest time over which the rate at rest is averaged, s.
const BIAS_MEMORY_S: f64 = 20.0;

/// Largest speed reported by a receiver at which the body may still be at rest, m/s.
pub(super) const MAX_SPEED_AT_REST_M_S: f64 = 0.7;
/// Standard deviation of a bias measured at rest, rad/s.
pub(super) const BIAS_SD_AT_REST_RAD_S: f64 = 8e-4;

/// Rest detector, which also averages the rate at rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RestDetector {
    rate_mean_rad_s: Vector3<f64>,
    force_mean_m_s2: Vector3<f64>,
    /// Integral of the rate since the last update, rad.
    rotation_rad: Vector3<f64>,
    moved: bool,
    quiet_s: f64,
    bias_rad_s: Vector3<f64>,
}

impl Default for RestDetector {
    fn default() -> Self {
        let zero = Vector3::zeros();
        Self {
            rate_mean_rad_s: zero,
            force_mean_m_s2: zero,
            rotation_rad: zero,
            moved: true,
            quiet_s: 0.0,
            bias_rad_s: zero,
        }
    }
}

impl RestDetector {
    /// Processes one gyro sample.
    #[inline]
    pub(super) fn observe(&mut self, rate_rad_s: Vector3<f64>, dt_s: f64) {
        let deviation_rad_s = rate_rad_s - self.rate_mean_rad_s;
        self.rotation_rad += rate_rad_s * dt_s;
        self.moved |= deviation_rad_s.norm_squared() >= MAX_RATE_DEVIATION_RAD_S * MAX_RATE_DEVIATION_RAD_S;
    }

    /// Evaluates the samples of the last `interval_s`. `force_m_s2` is the last specific force.
    pub(super) fn update(&mut self, force_m_s2: Vector3<f64>, interval_s: f64) {
        let rate_rad_s = core::mem::take(&mut self.rotation_rad) / interval_s;
        let deviation_m_s2 = force_m_s2 - self.force_mean_m_s2;
        self.moved |= deviation_m_s2.norm_squared() >= MAX_FORCE_DEVIATION_M_S2 * MAX_FORCE_DEVIATION_M_S2;
        if !(0.0..MAX_RATE_RAD_S * MAX_RATE_RAD_S).contains(&rate_rad_s.norm_squared()) {
            *self = Self::default();
            return;
        }
        let gain = (interval_s * (1.0 / MEAN_TIME_CONSTANT_S)).min(1.0);
        self.rate_mean_rad_s += (rate_rad_s - self.rate_mean_rad_s) * gain;
        self.force_mean_m_s2 += deviation_m_s2 * gain;
        if core::mem::take(&mut self.moved) || self.rate_mean_rad_s.amax() >= MAX_MEAN_RATE_RAD_S {
            self.quiet_s = 0.0;
            return;
        }
        self.quiet_s += interval_s;
        self.bias_rad_s += (rate_rad_s - self.bias_rad_s) * (interval_s / self.quiet_s.min(BIAS_MEMORY_S)).min(1.0);
    }

    /// Restarts the quiet time, because the sensors are not credible.
    #[inline]
    pub(super) fn interrupt(&mut self) {
        self.moved = true;
        self.quiet_s = 0.0;
    }

    /// Returns `true` if the body has been quiet long enough.
    #[inline]
    pub(super) fn is_detected(&self) -> bool {
        self.quiet_s >= MIN_QUIET_S
    }

    /// Returns the mean rate at rest, or `None` while no rest is detected.
    pub(super) fn bias_rad_s(&self) -> Option<Vector3<f64>> {
        self.is_detected().then_some(self.bias_rad_s)
    }

    /// Returns why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.quiet_s < 0.0).then_some("a time of rest below zero")
    }
}

scalars!(RestDetector: rate_mean_rad_s, force_mean_m_s2, rotation_rad, moved, quiet_s, bias_rad_s);
