//! Normalised errors: errors divided by the standard deviation that the stage reports.
//!
//! Input: an error and its reported standard deviation.
//!
//! Output: the ratios that 68 % and 95 % of the samples do not exceed. Each ratio is given as such
//! and divided by its ideal value.
//!
//! Failure: samples with a negative standard deviation or an undefined ratio are not counted. If
//! the standard deviation is 0 but the error is not, the sample is counted in the bin of the
//! largest ratios.
//!
//! If the standard deviation of a single axis is correct, 68 % of the ratios are below 1 and 95 %
//! below 2. The inclination error is the length of a vector with two such components, so its ratios
//! follow the Rayleigh distribution, whose quantiles √(−2 ln(1 − p)) are 1.51 and 2.45.

use serde::Serialize;

/// Coverages of the reported quantiles, as fractions of the samples.
const COVERAGES: [f64; 2] = [0.68, 0.95];
/// Ideal ratios for a single-axis error.
const ONE_AXIS_IDEAL: [f64; 2] = [1.0, 2.0];
/// Ideal ratios for the length of a vector with two components.
const TWO_AXIS_IDEAL: [f64; 2] = [1.51, 2.45];

/// Smallest ratio that the histogram resolves.
const MIN_RATIO: f64 = 1e-3;
/// Factor between the ratios of consecutive bins.
const BIN_FACTOR: f64 = 1.01;
/// Number of bins. They cover ratios up to about 1000.
const BINS: usize = 1390;

/// Histogram of ratios with logarithmic bins.
#[derive(Debug, Clone)]
pub struct RatioHistogram {
    bins: Vec<u64>,
    count: u64,
}

impl Default for RatioHistogram {
    fn default() -> Self {
        Self { bins: vec![0; BINS], count: 0 }
    }
}

impl RatioHistogram {
    /// Adds an error and its standard deviation, in the same unit.
    pub fn push(&mut self, error: f64, sd: f64) {
        let ratio = error.abs() / sd;
        if sd < 0.0 || ratio.is_nan() {
            return;
        }
        let bin = ((ratio / MIN_RATIO).ln() / BIN_FACTOR.ln()).clamp(0.0, (BINS - 1) as f64);
        self.bins[bin as usize] += 1;
        self.count += 1;
    }

    /// Adds the counts of another histogram.
    pub fn merge(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(bin, more)| *bin += more);
        self.count += other.count;
    }

    /// Returns the `coverage` quantile of the ratios, or `None` if the histogram is empty. The
    /// result is accurate to 1 %.
    fn quantile(&self, coverage: f64) -> Option<f64> {
        let rank = (coverage * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        let bin = self.bins.iter().position(|count| {
            below += count;
            below >= rank
        })?;
        Some(MIN_RATIO * BIN_FACTOR.powf(bin as f64 + 0.5))
    }

    fn quantiles(&self, ideal: [f64; 2]) -> Option<RatioQuantiles> {
        let [quantile_68, quantile_95] = COVERAGES.map(|coverage| self.quantile(coverage));
        let (quantile_68, quantile_95) = quantile_68.zip(quantile_95)?;
        let over_ideal = [quantile_68 / ideal[0], quantile_95 / ideal[1]];
        Some(RatioQuantiles { samples: self.count, quantile_68, quantile_95, over_ideal })
    }
}

/// Histograms of all errors with a reported standard deviation. Each ratio is an error divided by
/// its reported standard deviation.
#[derive(Debug, Clone, Default)]
pub struct RatioHistograms {
    /// Ratios of the inclination error.
    pub inclination: RatioHistogram,
    /// Ratios of the heading error while the heading is known.
    pub heading: RatioHistogram,
    /// Ratios of the course error while the course is known.
    pub course: RatioHistogram,
}

impl RatioHistograms {
    /// Adds the counts of other histograms.
    pub fn merge(&mut self, other: &Self) {
        self.inclination.merge(&other.inclination);
        self.heading.merge(&other.heading);
        self.course.merge(&other.course);
    }

    /// Returns the quantiles of each histogram.
    pub fn quantiles(&self) -> NormalisedErrors {
        NormalisedErrors {
            inclination: self.inclination.quantiles(TWO_AXIS_IDEAL),
            heading: self.heading.quantiles(ONE_AXIS_IDEAL),
            course: self.course.quantiles(ONE_AXIS_IDEAL),
        }
    }
}

/// Quantiles of the normalised errors; `None` without samples.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct NormalisedErrors {
    /// Quantiles of the inclination error, normalised by the standard deviation of one of its two
    /// axes.
    pub inclination: Option<RatioQuantiles>,
    /// Quantiles of the heading error.
    pub heading: Option<RatioQuantiles>,
    /// Quantiles of the course error.
    pub course: Option<RatioQuantiles>,
}

/// Quantiles of the ratio of an error to its reported standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RatioQuantiles {
    /// Number of samples.
    pub samples: u64,
    /// Ratio that 68 % of the samples do not exceed.
    pub quantile_68: f64,
    /// Ratio that 95 % of the samples do not exceed.
    pub quantile_95: f64,
    /// Both quantiles divided by their ideal values.
    ///
    /// The results are 1 if the reported standard deviation is correct, and above 1 if it is too
    /// small.
    pub over_ideal: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pairs of standard normal values from the Box–Muller transform of a lattice with two
    /// irrational steps (Weyl 1916).
    fn normals(count: u32) -> impl Iterator<Item = [f64; 2]> {
        (1..=count).map(f64::from).map(|k| {
            let (a, b) = ((k * 0.754_877_666_246_69) % 1.0, (k * 0.569_840_290_998_05) % 1.0);
            let (length, angle) = ((-2.0 * (1.0 - a).ln()).sqrt(), b * std::f64::consts::TAU);
            [length * angle.cos(), length * angle.sin()]
        })
    }

    #[test]
    fn ratio_quantiles_match_ideal_for_correct_sd() {
        let mut ratios = RatioHistograms::default();
        for [x, y] in normals(100_000) {
            ratios.inclination.push(0.3 * x.hypot(y), 0.3);
            ratios.heading.push(-2.0 * x, 2.0);
            ratios.course.push(y, 0.5);
        }
        let NormalisedErrors { inclination, heading, course } = ratios.quantiles();
        let is_near =
            |found: [f64; 2], ideal: [f64; 2]| found.iter().zip(ideal).all(|(a, b)| (a / b - 1.0).abs() < 0.025);
        assert!(is_near(inclination.unwrap().over_ideal, [1.0; 2]), "{inclination:?}");
        assert!(is_near(heading.unwrap().over_ideal, [1.0; 2]), "{heading:?}");
        assert!(is_near(course.unwrap().over_ideal, [2.0; 2]), "half the correct standard deviation: {course:?}");
    }

    #[test]
    fn ratios_merge_and_skip_invalid_sd() {
        let (mut one, mut two) = (RatioHistogram::default(), RatioHistogram::default());
        (0..68).for_each(|_| one.push(1.0, 2.0));
        (0..32).for_each(|_| two.push(-8.0, 2.0));
        [f64::NAN, -1.0].into_iter().for_each(|sd| two.push(1.0, sd));
        two.push(f64::NAN, 1.0);
        one.merge(&two);
        let quantiles = one.quantiles(ONE_AXIS_IDEAL).unwrap();
        assert_eq!(quantiles.samples, 100);
        assert!(
            (quantiles.quantile_68 / 0.5 - 1.0).abs() < 0.01 && (quantiles.quantile_95 / 4.0 - 1.0).abs() < 0.01,
            "{quantiles:?}"
        );
        let mut zero_sd = RatioHistogram::default();
        zero_sd.push(1.0, 0.0);
        assert!(zero_sd.quantiles(ONE_AXIS_IDEAL).unwrap().quantile_68 > 999.0);
        assert_eq!(RatioHistogram::default().quantiles(ONE_AXIS_IDEAL), None);
    }
}
