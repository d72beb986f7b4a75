//! Estimates the error of the leaky velocity with which the loop started on a moving body.
//!
//! After a hand-over, the loop starts with the velocity of the previous loop or with zero. The
//! velocity error tilts an initially correct level for as long as it persists in the loop. The
//! effect of this error on the loop is known. The error can therefore be estimated, and corrected,
//! from the tilt found by the gyro error filter. The less certain the adopted level, the smaller
//! the correction.

use super::level::{LoopError, LoopResponse};
use crate::{Complex, GRAVITY_M_S2, scalars::scalars};

/// Standard deviation of the loop's tilt error during a movement, rad (1°).
const LOOP_TILT_SD_RAD: f64 = 0.017_453_293;

/// Estimator of the error of the loop's initial velocity.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct InitialVelocityEstimator {
    /// Tilt and velocity error of the loop per unit of the initial velocity error.
    sensitivity: [f64; 2],
    variance_s2: f64,
}

impl InitialVelocityEstimator {
    /// Creates the estimator for an adopted velocity with the given standard deviation.
    pub(super) fn new(sd_m_s: f64) -> Self {
        let sd_s = sd_m_s / GRAVITY_M_S2;
        Self { sensitivity: [0.0, 1.0], variance_s2: sd_s * sd_s }
    }

    /// Updates the estimate after `interval_s` and returns the tilt and velocity errors to remove
    /// from the loop.
    ///
    /// `tilt_rad` is the loop's tilt error as estimated by the gyro error filter, and
    /// `tilt_variance_rad2` is the variance of this estimate. `t2_s` is the time constant of the
    /// tilt.
    pub(super) fn observe(
        &mut self,
        tilt_rad: Complex<f64>,
        tilt_variance_rad2: f64,
        interval_s: f64,
        t2_s: f64,
    ) -> LoopError {
        let [tilt, velocity] = self.sensitivity;
        self.sensitivity = LoopResponse::new(interval_s, t2_s).apply(tilt, velocity);
        // Other tilt errors of the loop stay correlated over its time constant, which raises their
        // effective variance.
        let noise_rad2 = (LOOP_TILT_SD_RAD * LOOP_TILT_SD_RAD + tilt_variance_rad2) * (t2_s / interval_s).max(1.0);
        let [tilt, velocity] = self.sensitivity;
        let gain = self.variance_s2 * tilt / (tilt * tilt * self.variance_s2 + noise_rad2);
        self.variance_s2 *= (1.0 - gain * tilt).max(0.0);
        let correction_s = tilt_rad * gain;
        LoopError { tilt: correction_s * tilt, velocity: correction_s * velocity }
    }

    /// Returns the standard deviation of the error remaining in the loop's velocity, m/s.
    pub(super) fn remaining_sd_m_s(&self) -> f64 {
        libm::sqrt(self.variance_s2) * libm::fabs(self.sensitivity[1]) * GRAVITY_M_S2
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.variance_s2 < 0.0).then_some("a variance below zero")
    }
}

scalars!(InitialVelocityEstimator: sensitivity, variance_s2);
