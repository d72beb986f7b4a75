//! Consistency of the filter's standard deviations with its innovations.
//!
//! The measure is the mean of the normalised innovations squared. It is 1 if noises and deviations
//! are as set (Bar-Shalom, *Estimation with Applications to Tracking and Navigation*, 5.4).
//!
//! - Worse sensors raise the mean of every velocity measurement. The reported deviations are
//!   multiplied by its square root.
//! - A receiver that is better than its settings lowers the mean, but this says less about the
//!   gyro's part of the error. The reported deviations are then reduced by an empirical law, fitted
//!   to cruise flights with a receiver of 0.05 m/s and with good and bad other sensors. The law
//!   holds only for the default noise settings.
//!
//! The filter's own deviations stay unchanged, because its gains belong to the settings.

use crate::scalars::Scalars;

/// Averaging time of the mean, s.
const MEMORY_S: f64 = 60.0;
/// Range of the mean that is used.
const MIN_MEAN: f64 = 0.05;
const MAX_MEAN: f64 = 16.0;
/// Constants of the law for a mean below 1: deviations are multiplied by factor · mean^exponent.
const DEFLATION_FACTOR: f64 = 1.44;
const DEFLATION_EXPONENT: f64 = 0.7;
/// Largest normalised innovation counted, in standard deviations.
const MAX_INNOVATION: f64 = 8.0;

/// Origin of the filter's noise settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoiseSettings {
    /// All noise settings have their default values.
    Default,
    /// At least one noise setting was changed.
    Custom,
}

/// Mean of the normalised innovations squared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Consistency {
    mean: f64,
}

impl Default for Consistency {
    fn default() -> Self {
        Self { mean: 1.0 }
    }
}

impl Consistency {
    /// Records the normalised innovations of a velocity, axis by axis, `interval_s` after the last
    /// ones.
    pub(super) fn record(&mut self, innovations: [f64; 3], interval_s: f64) {
        let square = |innovation: f64| innovation * innovation;
        let mean = innovations
            .into_iter()
            .map(|innovation| square(innovation.clamp(-MAX_INNOVATION, MAX_INNOVATION)))
            .sum::<f64>()
            / 3.0;
        self.mean += (mean - self.mean) * (interval_s / MEMORY_S).min(1.0);
    }

    /// Returns the factor to apply to the filter's standard deviations before they are reported.
    pub(super) fn sd_scale(&self, noises: NoiseSettings) -> f64 {
        match (self.mean.clamp(MIN_MEAN, MAX_MEAN), noises) {
            (mean, _) if mean >= 1.0 => libm::sqrt(mean),
            (mean, NoiseSettings::Default) => (DEFLATION_FACTOR * libm::pow(mean, DEFLATION_EXPONENT)).min(1.0),
            (_, NoiseSettings::Custom) => 1.0,
        }
    }

    /// Returns why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (!(0.0..=MAX_INNOVATION * MAX_INNOVATION).contains(&self.mean))
            .then_some("a mean of squared innovations out of range")
    }
}

impl Scalars for Consistency {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.mean.visit(visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sd_scale_follows_innovations_within_bounds() {
        for (innovation, with_default, with_custom) in [
            (1.0, 1.0, 1.0),
            (0.8, 1.0, 1.0),
            (0.25, 0.206_77, 1.0),
            (2.0, 2.0, 2.0),
            (0.0, 0.176_86, 1.0),
            (1e9, 4.0, 4.0),
        ] {
            let mut consistency = Consistency::default();
            (0..10_000).for_each(|_| consistency.record([innovation; 3], 0.2));
            for (noises, expected) in [(NoiseSettings::Default, with_default), (NoiseSettings::Custom, with_custom)] {
                let scale = consistency.sd_scale(noises);
                assert!((scale - expected).abs() < 1e-4, "{innovation}, {noises:?}: {scale}");
            }
            assert_eq!(consistency.validation_error(), None);
        }
    }
}
