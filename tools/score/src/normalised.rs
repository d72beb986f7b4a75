//! Errors over their own standard deviation: whether a stage is as good as it says.
//!
//! Input: an error and the standard deviation that the stage tells beside it. Output: below which ratio 68 and 95 % of the samples are, and how far that
//! is from the ideal. Time: none. Failure: a deviation that is not a number is not counted; one of 0 makes the largest ratio.
//!
//! An error of one axis is ideal where 68 % are below 1 and 95 % below 2 deviations. The inclination is the length of two such errors, so 1.51 and 2.45:
//! √(−2 ln(1 − p)), the quantiles of Rayleigh's distribution.

use serde::Serialize;

/// The parts of the samples whose largest ratio is told.
const PARTS: [f64; 2] = [0.68, 0.95];
/// The ideal of an error of one axis.
const IDEAL_ONE_AXIS: [f64; 2] = [1.0, 2.0];
/// The ideal of the length of two.
const IDEAL_TWO_AXES: [f64; 2] = [1.51, 2.45];

/// The ratios that are told apart: from the least to the largest, each bin wider than the one before by a hundredth.
const LEAST: f64 = 1e-3;
const BIN: f64 = 1.01;
/// Up to about 1000.
const BINS: usize = 1390;

/// How many ratios are in each bin.
#[derive(Debug, Clone)]
pub struct Ratios {
    bins: Vec<u64>,
    count: u64,
}

impl Default for Ratios {
    fn default() -> Self {
        Self { bins: vec![0; BINS], count: 0 }
    }
}

impl Ratios {
    /// Takes an error and its standard deviation, in the same unit.
    pub fn push(&mut self, error: f64, sd: f64) {
        let ratio = error.abs() / sd;
        if sd < 0.0 || ratio.is_nan() {
            return;
        }
        let bin = ((ratio / LEAST).ln() / BIN.ln()).clamp(0.0, (BINS - 1) as f64);
        self.bins[bin as usize] += 1;
        self.count += 1;
    }

    /// Those of another trial, too.
    pub fn add(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(bin, more)| *bin += more);
        self.count += other.count;
    }

    /// The ratio that a part of the samples does not exceed, to a hundredth of itself; none of none.
    fn quantile(&self, part: f64) -> Option<f64> {
        let rank = (part * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        let bin = self.bins.iter().position(|count| {
            below += count;
            below >= rank
        })?;
        Some(LEAST * BIN.powf(bin as f64 + 0.5))
    }

    fn told(&self, ideal: [f64; 2]) -> Option<Quantiles> {
        let [part_68, part_95] = PARTS.map(|part| self.quantile(part));
        let (part_68, part_95) = part_68.zip(part_95)?;
        let over_ideal = [part_68 / ideal[0], part_95 / ideal[1]];
        Some(Quantiles { samples: self.count, part_68, part_95, over_ideal })
    }
}

/// The ratios of everything that has a standard deviation.
#[derive(Debug, Clone, Default)]
pub struct Deviations {
    /// Of the inclination.
    pub inclination: Ratios,
    /// Of the heading, where it is counted from north.
    pub heading: Ratios,
    /// Of the course, likewise.
    pub course: Ratios,
}

impl Deviations {
    /// Those of another trial, too.
    pub fn add(&mut self, other: &Self) {
        self.inclination.add(&other.inclination);
        self.heading.add(&other.heading);
        self.course.add(&other.course);
    }

    /// What is told of them.
    pub fn told(&self) -> Normalised {
        Normalised {
            inclination: self.inclination.told(IDEAL_TWO_AXES),
            heading: self.heading.told(IDEAL_ONE_AXIS),
            course: self.course.told(IDEAL_ONE_AXIS),
        }
    }
}

/// Errors over their standard deviations; `None` where there are none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Normalised {
    /// Of the inclination, against the deviation of each of its two axes.
    pub inclination: Option<Quantiles>,
    /// Of the heading.
    pub heading: Option<Quantiles>,
    /// Of the course.
    pub course: Option<Quantiles>,
}

/// Below which ratio of error and deviation a part of the samples is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Samples.
    pub samples: u64,
    /// The ratio that 68 % do not exceed.
    pub part_68: f64,
    /// The ratio that 95 % do not exceed.
    pub part_95: f64,
    /// Both over the ideal: 1 for a stage that is as good as it says, above 1 for one that says too much of itself.
    pub over_ideal: [f64; 2],
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    /// Normal numbers by Box and Muller of the points of a lattice (Weyl 1916, with two irrational steps).
    fn normals(count: u32) -> impl Iterator<Item = [f64; 2]> {
        (1..=count).map(f64::from).map(|k| {
            let (a, b) = ((k * 0.754_877_666_246_69) % 1.0, (k * 0.569_840_290_998_05) % 1.0);
            let (length, angle) = ((-2.0 * (1.0 - a).ln()).sqrt(), b * std::f64::consts::TAU);
            [length * angle.cos(), length * angle.sin()]
        })
    }

    #[test]
    fn a_stage_that_is_as_good_as_it_says_has_ratios_of_one() {
        let mut deviations = Deviations::default();
        for [x, y] in normals(100_000) {
            deviations.inclination.push(0.3 * x.hypot(y), 0.3);
            deviations.heading.push(-2.0 * x, 2.0);
            deviations.course.push(y, 0.5);
        }
        let Normalised { inclination, heading, course } = deviations.told();
        let near = |found: [f64; 2], ideal: [f64; 2]| found.iter().zip(ideal).all(|(a, b)| (a / b - 1.0).abs() < 0.025);
        assert!(near(inclination.unwrap().over_ideal, [1.0; 2]), "{inclination:?}");
        assert!(near(heading.unwrap().over_ideal, [1.0; 2]), "{heading:?}");
        assert!(near(course.unwrap().over_ideal, [2.0; 2]), "half the deviation that it should tell: {course:?}");
    }

    #[test]
    fn trials_are_put_together_and_what_is_no_deviation_is_left_out() {
        let (mut one, mut two) = (Ratios::default(), Ratios::default());
        (0..68).for_each(|_| one.push(1.0, 2.0));
        (0..32).for_each(|_| two.push(-8.0, 2.0));
        [f64::NAN, -1.0].into_iter().for_each(|sd| two.push(1.0, sd));
        two.push(f64::NAN, 1.0);
        one.add(&two);
        let told = one.told(IDEAL_ONE_AXIS).unwrap();
        assert_eq!(told.samples, 100);
        assert!((told.part_68 / 0.5 - 1.0).abs() < 0.01 && (told.part_95 / 4.0 - 1.0).abs() < 0.01, "{told:?}");
        let mut sure = Ratios::default();
        sure.push(1.0, 0.0);
        assert!(sure.told(IDEAL_ONE_AXIS).unwrap().part_68 > 999.0);
        assert_eq!(Ratios::default().told(IDEAL_ONE_AXIS), None);
    }
}
