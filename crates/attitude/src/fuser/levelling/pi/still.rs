//! Standstill: rate and force do not move from their own mean, for longer than a cruising vehicle keeps so quiet.
//!
//! The rate is held against a mean of its own, so that its bias does not hide the standstill. A steady turn slower than 1 °/s that
//! is as smooth as a table is taken for a bias.

use crate::{Vector3, numbers::Numbers};

/// Time constant of the means and of the mean squares about them, s.
const MEAN_S: f64 = 2.0;
/// RMS of the rate about its mean at standstill, rad/s: 0.3 °/s; a vehicle in calm air rolls and pitches by more.
const RATE_RMS_RAD_S: f64 = 0.0052;
/// The same, where a receiver says that the vehicle stands, rad/s: 0.8 °/s.
const RATE_RMS_SEEN_RAD_S: f64 = 0.014;
/// RMS of the force about its mean at standstill, and where a receiver says so, m/s².
const FORCE_RMS_M_S2: f64 = 0.08;
const FORCE_RMS_SEEN_M_S2: f64 = 0.15;
/// Largest component of a mean rate that can be a bias, rad/s: 1 °/s.
const BIAS_MAX_RAD_S: f64 = 0.017_453;
/// A speed over ground below which a vehicle stands, m/s.
const SPEED_MAX_M_S: f64 = 0.7;
/// How long it must have been quiet, s.
const QUIET_S: f64 = 5.0;

/// Finds standstill, and the mean rate during it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Still {
    rate_mean_rad_s: Vector3<f64>,
    rate_square_rad2_s2: f64,
    force_mean_m_s2: Vector3<f64>,
    force_square_m2_s4: f64,
    started: bool,
    quiet_s: f64,
}

impl Still {
    /// One sample, with the speed over ground where it is known; the mean rate, once it has been quiet for long enough.
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
        let gain = (dt_s / MEAN_S).min(1.0);
        let (rate, force) = (rate_rad_s - self.rate_mean_rad_s, force_m_s2 - self.force_mean_m_s2);
        self.rate_mean_rad_s += rate * gain;
        self.force_mean_m_s2 += force * gain;
        self.rate_square_rad2_s2 += (rate.norm_squared() - self.rate_square_rad2_s2) * gain;
        self.force_square_m2_s4 += (force.norm_squared() - self.force_square_m2_s4) * gain;
        let (rate_rms, force_rms) = match speed_m_s {
            Some(_) => (RATE_RMS_SEEN_RAD_S, FORCE_RMS_SEEN_M_S2),
            None => (RATE_RMS_RAD_S, FORCE_RMS_M_S2),
        };
        let quiet = self.rate_square_rad2_s2 < rate_rms * rate_rms
            && self.force_square_m2_s4 < force_rms * force_rms
            && self.rate_mean_rad_s.amax() < BIAS_MAX_RAD_S
            && speed_m_s.is_none_or(|speed_m_s| speed_m_s < SPEED_MAX_M_S);
        self.quiet_s = if quiet { (self.quiet_s + dt_s).min(QUIET_S) } else { 0.0 };
        (self.quiet_s >= QUIET_S).then_some(self.rate_mean_rad_s)
    }

    /// The sensors cannot be believed; standstill starts anew.
    pub(super) fn interrupt(&mut self) {
        *self = Self::default();
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let negative = self.rate_square_rad2_s2 < 0.0 || self.force_square_m2_s4 < 0.0 || self.quiet_s < 0.0;
        negative.then_some("a mean square or a time below zero")
    }
}

impl Numbers for Still {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.rate_mean_rad_s.visit(visit);
        self.rate_square_rad2_s2.visit(visit);
        self.force_mean_m_s2.visit(visit);
        self.force_square_m2_s4.visit(visit);
        self.started.visit(visit);
        self.quiet_s.visit(visit);
    }
}
