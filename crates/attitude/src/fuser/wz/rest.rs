//! Rest: the gyro and the accelerometer have not moved from their own mean for a while.
//!
//! A steady turn about the vertical, slower than 2 °/s and with no other motion, looks the same and is taken for a bias: the
//! tilt does not suffer, heading does.

use crate::{Vector3, stage::Numbers};

/// Time constant of the mean that samples are held against, s.
const MEAN_S: f64 = 0.5;
/// Largest distance of a rate from its mean at rest, rad/s: 2 °/s.
const RATE_SPREAD_RAD_S: f64 = 0.034_906_585;
/// Largest component of the mean rate that can be a bias, rad/s: 2 °/s.
const RATE_MEAN_RAD_S: f64 = 0.034_906_585;
/// Largest distance of a force from its mean at rest, m/s².
const FORCE_SPREAD_M_S2: f64 = 0.5;
/// How long it must have been quiet, s.
const QUIET_S: f64 = 1.5;
/// Longest memory of the mean rate at rest, s.
const BIAS_MEMORY_S: f64 = 20.0;

/// Finds rest, and the mean rate during it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Rest {
    rate_mean_rad_s: Vector3<f64>,
    force_mean_m_s2: Vector3<f64>,
    started: bool,
    quiet_s: f64,
    bias_rad_s: Vector3<f64>,
}

impl Rest {
    /// One sample; true once it has been quiet long enough.
    #[inline]
    pub(super) fn step(&mut self, rate: Vector3<f64>, force: Vector3<f64>, dt_s: f64) -> bool {
        if !self.started {
            (self.rate_mean_rad_s, self.force_mean_m_s2, self.started) = (rate, force, true);
        }
        let gain = (dt_s * (1.0 / MEAN_S)).min(1.0);
        let (rate_off, force_off) = (rate - self.rate_mean_rad_s, force - self.force_mean_m_s2);
        self.rate_mean_rad_s += rate_off * gain;
        self.force_mean_m_s2 += force_off * gain;
        let left2 = (1.0 - gain) * (1.0 - gain);
        let quiet = rate_off.norm_squared() * left2 < RATE_SPREAD_RAD_S * RATE_SPREAD_RAD_S
            && force_off.norm_squared() * left2 < FORCE_SPREAD_M_S2 * FORCE_SPREAD_M_S2
            && self.rate_mean_rad_s.amax() < RATE_MEAN_RAD_S;
        if !quiet {
            self.interrupt();
            return false;
        }
        self.quiet_s += dt_s;
        self.bias_rad_s += (rate - self.bias_rad_s) * (dt_s / self.quiet_s.min(BIAS_MEMORY_S)).min(1.0);
        self.quiet_s >= QUIET_S
    }

    /// The mean rate since rest began.
    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        self.bias_rad_s
    }

    /// The sensors cannot be believed; rest starts anew.
    pub(super) fn interrupt(&mut self) {
        self.quiet_s = 0.0;
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
        self.started.visit(visit);
        self.quiet_s.visit(visit);
        self.bias_rad_s.visit(visit);
    }
}
