//! Standstill detector. The body stands still while gyro and accelerometer stay close to their
//! means and the receiver, if present, reports a speed near zero.

use crate::{Vector3, scalars::scalars};

/// Time constant of the means and of the mean squared deviations, s.
const MEAN_TIME_CONSTANT_S: f64 = 1.0;
/// Time without movement after which standstill is detected, s.
const MIN_STILL_S: f64 = 2.0;
/// Time between two bias measurements, s.
const INTERVAL_S: f64 = 0.5;

/// Limits within which the body counts as standing still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StillnessLimits {
    /// Upper limit of the RMS deviation of the rate from its mean, rad/s.
    rate_rad_s: f64,
    /// Upper limit of the RMS deviation of the specific force from its mean, m/s².
    force_m_s2: f64,
    /// Largest component of the mean rate that is accepted as a bias, rad/s.
    mean_rad_s: f64,
}

/// Limits if the receiver reports a speed near zero: 0.8 °/s and 0.15 m/s². They are wide enough
/// that an idling engine does not count as motion.
pub(super) const WITH_RECEIVER: StillnessLimits =
    StillnessLimits { rate_rad_s: 0.013_962_634, force_m_s2: 0.15, mean_rad_s: 0.087_266_463 };
/// Limits without a receiver: 0.3 °/s, 0.08 m/s² and a mean rate of 1 °/s. They are tighter
/// than with a receiver, because a steady turn in still air looks like standstill.
pub(super) const WITHOUT_RECEIVER: StillnessLimits =
    StillnessLimits { rate_rad_s: 0.005_235_988, force_m_s2: 0.08, mean_rad_s: 0.017_453_293 };

/// Standstill detector, which also averages the rate.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct StandstillDetector {
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
    rate_variance: f64,
    force_variance: f64,
    started: bool,
    still_s: f64,
    since_report_s: f64,
}

impl StandstillDetector {
    /// Processes a sample. Returns the mean rate (rad/s) every half second of standstill.
    ///
    /// The body is considered moving while `limits` is `None`.
    pub(super) fn update(
        &mut self,
        rate_rad_s: Vector3<f64>,
        force_m_s2: Vector3<f64>,
        dt_s: f64,
        limits: Option<&StillnessLimits>,
    ) -> Option<Vector3<f64>> {
        if !self.started {
            *self = Self { rate_rad_s, force_m_s2, started: true, ..Self::default() };
        }
        let gain = (dt_s / MEAN_TIME_CONSTANT_S).min(1.0);
        self.rate_rad_s += (rate_rad_s - self.rate_rad_s) * gain;
        self.force_m_s2 += (force_m_s2 - self.force_m_s2) * gain;
        self.rate_variance += ((rate_rad_s - self.rate_rad_s).norm_squared() - self.rate_variance) * gain;
        self.force_variance += ((force_m_s2 - self.force_m_s2).norm_squared() - self.force_variance) * gain;
        let quiet = limits.is_some_and(|limits| {
            self.rate_variance < limits.rate_rad_s * limits.rate_rad_s
                && self.force_variance < limits.force_m_s2 * limits.force_m_s2
                && self.rate_rad_s.amax() < limits.mean_rad_s
        });
        if !quiet {
            self.still_s = 0.0;
            return None;
        }
        self.still_s = (self.still_s + dt_s).min(1e3);
        self.since_report_s += dt_s;
        if self.still_s < MIN_STILL_S || self.since_report_s < INTERVAL_S {
            return None;
        }
        self.since_report_s = 0.0;
        Some(self.rate_rad_s)
    }

    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }
}

scalars!(StandstillDetector: rate_rad_s, force_m_s2, started, rate_variance, force_variance, still_s, since_report_s);
