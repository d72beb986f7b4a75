//! Sums over one propagation interval of the covariance.

use crate::{Vector3, scalars::scalars};

/// Averaging time of the accelerometer noise, s.
const NOISE_MEMORY_S: f64 = 5.0;

/// Sums since the last propagation of the covariance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct IntervalSums {
    pub(super) duration_s: f64,
    /// Time without a specific force since the last propagation of the covariance, s.
    pub(super) force_outage_s: f64,
    /// Integral of the specific force in reference axes, ∫ f dt, m/s.
    pub(super) force_m_s: Vector3<f64>,
    /// Integral of the squared rate, ∫ |ω|² dt, rad²/s.
    pub(super) rate2_rad2_s: f64,
    last_force_m_s2: Vector3<f64>,
    /// Sample-to-sample noise of the specific force, as the power density of white noise, m²/s³.
    pub(super) force_noise_m2_s3: f64,
}

impl IntervalSums {
    /// Updates the force noise. For white noise, the mean squared difference of successive samples
    /// is twice the variance on each axis.
    pub(super) fn update_force_noise(&mut self, force_m_s2: Vector3<f64>, dt_s: f64) {
        let difference_m_s2 = force_m_s2 - self.last_force_m_s2;
        let power_m2_s3 = difference_m_s2.norm_squared() / 6.0 * dt_s;
        if self.last_force_m_s2 != Vector3::zeros() {
            self.force_noise_m2_s3 += (power_m2_s3 - self.force_noise_m2_s3) * (dt_s / NOISE_MEMORY_S).min(1.0);
        }
        self.last_force_m_s2 = force_m_s2;
    }

    pub(super) fn reset(&mut self) {
        let Self { last_force_m_s2, force_noise_m2_s3, .. } = *self;
        *self = Self { last_force_m_s2, force_noise_m2_s3, ..Self::default() };
    }
}

impl IntervalSums {
    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let powers = [self.duration_s, self.force_outage_s, self.rate2_rad2_s, self.force_noise_m2_s3];
        powers.iter().any(|power| *power < 0.0).then_some("a sum of squares or of times below zero")
    }
}

scalars!(IntervalSums: duration_s, force_outage_s, force_m_s, rate2_rad2_s, last_force_m_s2, force_noise_m2_s3);
