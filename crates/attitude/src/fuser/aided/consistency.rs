//! Consistency of the filter's standard deviations with its innovations.
//!
//! The measure is the mean of the normalised innovations squared. It is 1 if the sensor errors are
//! as large as the filter assumes (Bar-Shalom, *Estimation with Applications to Tracking and
//! Navigation*, 5.4).
//!
//! - Sensors that are worse than their settings raise the mean. The reported deviations are
//!   therefore multiplied by the square root of the mean.
//! - A receiver that is better than its settings lowers the mean, but this reveals less about the
//!   part of the error that the gyro causes. The factor on the reported deviations is then not the
//!   square root but an empirical law of the mean. The law was fitted to cruise flights with a
//!   receiver noise of 0.05 m/s. The other sensors were good in some of the flights and bad in the
//!   rest. The law holds only for the default noise settings.
//!
//! The filter's own deviations are not scaled, because its gains must follow from the settings.

use crate::scalars::scalars;

/// Averaging time of the normalised innovations squared, s.
const MEMORY_S: f64 = 60.0;
/// Smallest mean from which the factor on the reported deviations is computed. Smaller means are
/// clamped.
const MIN_MEAN: f64 = 0.05;
/// Largest mean from which the factor on the reported deviations is computed. Larger means are
/// clamped.
const MAX_MEAN: f64 = 16.0;
/// Coefficient c of the empirical law.
///
/// If the mean is below 1, the reported deviations are multiplied by c · mean^e, but at most by 1.
const DEFLATION_FACTOR: f64 = 1.44;
/// Exponent e of the empirical law.
const DEFLATION_EXPONENT: f64 = 0.7;
/// Largest magnitude of a normalised innovation, in standard deviations. Larger ones are clamped.
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
    /// Records the normalised innovations of a velocity, one per axis. `interval_s` is the time
    /// since the previous velocity.
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

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (!(0.0..=MAX_INNOVATION * MAX_INNOVATION).contains(&self.mean))
            .then_some("a mean of squared innovations out of range")
    }
}

scalars!(Consistency: mean);

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
