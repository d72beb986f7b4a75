//! Sums over one interval of the covariance.

use crate::{Vector3, numbers::Numbers};

/// Memory of the accelerometer's spread, s.
const SPREAD_MEMORY_S: f64 = 5.0;

/// What happened since the last step of the covariance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Sums {
    pub(super) length_s: f64,
    /// Of that, without an accelerometer.
    pub(super) unseen_s: f64,
    /// ∫ f dt, m/s, reference axes.
    pub(super) force_m_s: Vector3<f64>,
    /// ∫ |w'|² dt, rad²/s.
    pub(super) rate2_rad2_s: f64,
    force_before_m_s2: Vector3<f64>,
    /// Spread of the specific force from sample to sample, as the power of a white noise, m²/s³.
    pub(super) spread_m2_s3: f64,
}

impl Sums {
    /// White noise differs from itself a sample ago by twice its variance on each axis.
    pub(super) fn see(&mut self, force_m_s2: Vector3<f64>, dt_s: f64) {
        let difference_m_s2 = force_m_s2 - self.force_before_m_s2;
        let power_m2_s3 = difference_m_s2.norm_squared() / 6.0 * dt_s;
        if self.force_before_m_s2 != Vector3::zeros() {
            self.spread_m2_s3 += (power_m2_s3 - self.spread_m2_s3) * (dt_s / SPREAD_MEMORY_S).min(1.0);
        }
        self.force_before_m_s2 = force_m_s2;
    }

    pub(super) fn begin(&mut self) {
        let Self { force_before_m_s2, spread_m2_s3, .. } = *self;
        *self = Self { force_before_m_s2, spread_m2_s3, ..Self::default() };
    }
}

impl Sums {
    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let powers = [self.length_s, self.unseen_s, self.rate2_rad2_s, self.spread_m2_s3];
        powers.iter().any(|power| *power < 0.0).then_some("a sum of squares or of times below zero")
    }
}

impl Numbers for Sums {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.length_s.visit(visit);
        self.unseen_s.visit(visit);
        self.force_m_s.visit(visit);
        self.rate2_rad2_s.visit(visit);
        self.force_before_m_s2.visit(visit);
        self.spread_m2_s3.visit(visit);
    }
}
