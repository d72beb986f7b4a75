//! Whether the filter's own standard deviations are true: the mean of its normalised innovations squared.
//!
//! Where noises and deviations are what the settings say, the mean is 1 (Bar-Shalom, *Estimation with Applications to Tracking and
//! Navigation*, 5.4). Worse sensors show in every velocity that is told: the deviations are told larger by the root of the mean. A
//! receiver that is better than its settings lowers the mean as well, but says less of the gyro's part of the error: there they are told
//! smaller by what was found to be true on cruise flights with a receiver of 0.05 m/s, with good and with bad sensors besides. It is
//! true of the noises that the settings have where nobody sets them; of others a mean below 1 says nothing. The filter's own are left
//! alone: its gains are those of the settings.

use crate::numbers::Numbers;

/// Memory of the mean, s.
const MEMORY_S: f64 = 60.0;
/// Bounds of the mean.
const LEAST: f64 = 0.05;
const MOST: f64 = 16.0;
/// Of a mean below 1: the factor of the deviations is this times the mean's power.
const FACTOR: f64 = 1.44;
const POWER: f64 = 0.7;
/// Most that one innovation counts, in standard deviations.
const OUTLIER: f64 = 8.0;

/// Whose the noises of the filter are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Noises {
    /// Those of the settings as they are.
    Usual,
    /// At least one was set.
    Set,
}

/// The mean.
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
    /// Innovations of a velocity, axis by axis, over their own standard deviations, `interval_s` after the last.
    pub(super) fn see(&mut self, innovations: [f64; 3], interval_s: f64) {
        let square = |one: f64| one * one;
        let mean = innovations.into_iter().map(|one| square(one.clamp(-OUTLIER, OUTLIER))).sum::<f64>() / 3.0;
        self.mean += (mean - self.mean) * (interval_s / MEMORY_S).min(1.0);
    }

    /// What the filter's own standard deviations are to be multiplied by, with its own noises or with those that somebody set.
    pub(super) fn scale(&self, noises: Noises) -> f64 {
        match (self.mean.clamp(LEAST, MOST), noises) {
            (mean, _) if mean >= 1.0 => libm::sqrt(mean),
            (mean, Noises::Usual) => (FACTOR * libm::pow(mean, POWER)).min(1.0),
            (_, Noises::Set) => 1.0,
        }
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (!(0.0..=OUTLIER * OUTLIER).contains(&self.mean)).then_some("a mean of squares outside its bounds")
    }
}

impl Numbers for Consistency {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.mean.visit(visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_follow_the_innovations_and_stay_within_bounds() {
        for (innovation, usual, set) in [
            (1.0, 1.0, 1.0),
            (0.8, 1.0, 1.0),
            (0.25, 0.206_77, 1.0),
            (2.0, 2.0, 2.0),
            (0.0, 0.176_86, 1.0),
            (1e9, 4.0, 4.0),
        ] {
            let mut consistency = Consistency::default();
            (0..10_000).for_each(|_| consistency.see([innovation; 3], 0.2));
            for (noises, expected) in [(Noises::Usual, usual), (Noises::Set, set)] {
                let scale = consistency.scale(noises);
                assert!((scale - expected).abs() < 1e-4, "{innovation}, {noises:?}: {scale}");
            }
            assert_eq!(consistency.flaw(), None);
        }
    }
}
