//! Standstill detection. The body stands still if rate and force stay near their means for longer
//! than they do in a smooth cruise.
//!
//! The rate is compared with its own mean, so that a bias does not hide the standstill. A very
//! smooth steady turn slower than 1 °/s is mistaken for a bias.

use crate::{Vector3, fuser::rest::MAX_SPEED_AT_REST_M_S, scalars::scalars};

/// Time constant of the means and of the variances about them, s.
const AVERAGING_S: f64 = 2.0;
/// Largest RMS deviation of the rate from its mean at standstill, rad/s (0.3 °/s). A moving vehicle
/// exceeds it even in calm air.
const MAX_RATE_RMS_RAD_S: f64 = 0.0052;
/// Largest RMS deviation of the rate from its mean if a receiver reports standstill, rad/s (0.8
/// °/s).
const MAX_AIDED_RATE_RMS_RAD_S: f64 = 0.014;
/// Largest RMS deviation of the force from its mean at standstill without a receiver, m/s².
const MAX_FORCE_RMS_M_S2: f64 = 0.08;
/// Largest RMS deviation of the force from its mean if a receiver reports standstill, m/s².
const MAX_AIDED_FORCE_RMS_M_S2: f64 = 0.15;
/// Largest component of a mean rate that is accepted as a bias, rad/s (1 °/s).
const MAX_BIAS_RAD_S: f64 = 0.017_453;
/// Minimum duration of the quiet phase, s.
const MIN_QUIET_S: f64 = 5.0;

/// Standstill detector, which also averages the rate.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct StandstillDetector {
    rate_mean_rad_s: Vector3<f64>,
    rate_square_rad2_s2: f64,
    force_mean_m_s2: Vector3<f64>,
    force_square_m2_s4: f64,
    started: bool,
    quiet_s: f64,
}

impl StandstillDetector {
    /// Processes a sample and the speed over ground, if known. Returns the mean rate if the body
    /// stands still.
    pub(super) fn step(
        &mut self,
        rate_rad_s: Vector3<f64>,
        force_m_s2: Vector3<f64>,
        speed_m_s: Option<f64>,
        dt_s: f64,
    ) -> Option<Vector3<f64>> {
        if !self.started {
            *self = Self { rate_mean_rad_s: rate_rad_s, force_mean_m_s2: force_m_s2, started: true, ..Self::default() };
        }
        let gain = (dt_s / AVERAGING_S).min(1.0);
        let (rate, force) = (rate_rad_s - self.rate_mean_rad_s, force_m_s2 - self.force_mean_m_s2);
        self.rate_mean_rad_s += rate * gain;
        self.force_mean_m_s2 += force * gain;
        self.rate_square_rad2_s2 += (rate.norm_squared() - self.rate_square_rad2_s2) * gain;
        self.force_square_m2_s4 += (force.norm_squared() - self.force_square_m2_s4) * gain;
        let (rate_rms, force_rms) = match speed_m_s {
            Some(_) => (MAX_AIDED_RATE_RMS_RAD_S, MAX_AIDED_FORCE_RMS_M_S2),
            None => (MAX_RATE_RMS_RAD_S, MAX_FORCE_RMS_M_S2),
        };
        let quiet = self.rate_square_rad2_s2 < rate_rms * rate_rms
            && self.force_square_m2_s4 < force_rms * force_rms
            && self.rate_mean_rad_s.amax() < MAX_BIAS_RAD_S
            && speed_m_s.is_none_or(|speed_m_s| speed_m_s < MAX_SPEED_AT_REST_M_S);
        self.quiet_s = if quiet { (self.quiet_s + dt_s).min(MIN_QUIET_S) } else { 0.0 };
        (self.quiet_s >= MIN_QUIET_S).then_some(self.rate_mean_rad_s)
    }

    /// Restarts the detection because the sensors cannot be trusted.
    pub(super) fn interrupt(&mut self) {
        *self = Self::default();
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let negative = self.rate_square_rad2_s2 < 0.0 || self.force_square_m2_s4 < 0.0 || self.quiet_s < 0.0;
        negative.then_some("a negative variance or time")
    }
}

scalars!(StandstillDetector:
    rate_mean_rad_s, rate_square_rad2_s2, force_mean_m_s2, force_square_m2_s4, started, quiet_s
);
