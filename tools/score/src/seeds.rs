//! A simulation with many seeds, and how its errors spread over them.
//!
//! Input: a simulation's name with `seed=A..B`. Output: one name for each seed; of their errors mean, deviation and quantiles. Time: none.
//! Failure: a range that is empty or too long.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::{
    ScoreError,
    normalised::Deviations,
    table::{Errors, TrialScore},
    verdict::least_of,
};

/// Seeds of one simulation at most.
pub const MAX_SEEDS: u64 = 10_000;
/// The quantiles that are told.
pub const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];

/// How errors spread over seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// Seeds.
    pub seeds: u64,
    /// Standard deviation.
    pub sd: Errors,
    /// The errors that 5, 50 and 95 % of the seeds do not exceed.
    pub quantiles: [Errors; QUANTILES.len()],
    /// The seed with the largest error in total; in inclination where no heading is known.
    pub worst_seed: u64,
    /// Its errors.
    pub worst: Errors,
    /// Of each error that is known, the seed at which it is the largest.
    pub worst_seed_of: BTreeMap<&'static str, u64>,
}

/// The simulations of a range of seeds; none where the name has no range.
pub fn each(text: &str) -> Result<Option<Vec<(u64, String)>>, ScoreError> {
    let Some((name, query)) = text.split_once('?').filter(|(name, _)| name.starts_with("sim:")) else {
        return Ok(None);
    };
    let range = |pair: &str| pair.strip_prefix("seed=")?.split_once("..").map(|(a, b)| (a.to_owned(), b.to_owned()));
    let Some((first, last)) = query.split('&').find_map(range) else { return Ok(None) };
    let refused = || ScoreError::Seeds { text: text.into() };
    let (first, last): (u64, u64) = first.parse().ok().zip(last.parse().ok()).ok_or_else(refused)?;
    if last.checked_sub(first).is_none_or(|more| more >= MAX_SEEDS) {
        return Err(refused());
    }
    let of = |seed: u64| {
        let pairs =
            query.split('&').map(|pair| if range(pair).is_some() { format!("seed={seed}") } else { pair.into() });
        format!("{name}?{}", pairs.collect::<Vec<_>>().join("&"))
    };
    Ok(Some((first..=last).map(|seed| (seed, of(seed))).collect()))
}

/// The score over all seeds, as that of one trial of that name.
pub fn joined(name: &str, of: &[(u64, TrialScore)]) -> TrialScore {
    let mut deviations = Deviations::default();
    of.iter().for_each(|(_, score)| deviations.add(&score.deviations));
    TrialScore {
        name: name.into(),
        error: Errors::mean(&of.iter().map(|(_, score)| score.error).collect::<Vec<_>>()),
        heading_is_known: of.iter().all(|(_, score)| score.heading_is_known),
        normalised: deviations.told(),
        deviations,
        scored: of.iter().map(|(_, score)| score.scored).sum(),
        ticks: of.iter().map(|(_, score)| score.ticks).sum(),
        ns_per_update: of.iter().find_map(|(_, score)| score.ns_per_update),
        spread: spread(of),
    }
}

fn spread(of: &[(u64, TrialScore)]) -> Option<Spread> {
    // What has a mean: of a heading that not every seed knows there is no spread.
    let has = Errors::mean(&of.iter().map(|(_, score)| score.error).collect::<Vec<_>>()).each().map(|it| it.is_some());
    let (_, ranked_by) = least_of(of.iter().all(|(_, score)| score.heading_is_known));
    let error = |score: &TrialScore| ranked_by(&score.error.attitude).unwrap_or(f64::NEG_INFINITY);
    let (worst_seed, worst) = of.iter().max_by(|(_, a), (_, b)| error(a).total_cmp(&error(b)))?;
    let sorted: [Vec<f64>; _] = std::array::from_fn(|at| {
        let mut sorted: Vec<f64> =
            of.iter().filter(|_| has[at]).filter_map(|(_, score)| score.error.each()[at]).collect();
        sorted.sort_by(f64::total_cmp);
        sorted
    });
    let errors = |of: &dyn Fn(&[f64]) -> Option<f64>| Errors::of_each(sorted.each_ref().map(|sorted| of(sorted)));
    let worst_of = |(at, name): (usize, &'static str)| {
        let known =
            of.iter().filter(|_| has[at]).filter_map(|(seed, score)| Some((seed, score.error.each()[at]?.abs())));
        let (seed, _) = known.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        Some((name, *seed))
    };
    Some(Spread {
        seeds: of.len() as u64,
        sd: errors(&deviation),
        quantiles: QUANTILES.map(|part| errors(&|sorted| quantile(sorted, part))),
        worst_seed: *worst_seed,
        worst: worst.error,
        worst_seed_of: Errors::NAMES.into_iter().enumerate().filter_map(worst_of).collect(),
    })
}

/// Of a sample; none of fewer than two.
fn deviation(of: &[f64]) -> Option<f64> {
    let count = of.len() as f64;
    let mean = of.iter().sum::<f64>() / count;
    let squares: f64 = of.iter().map(|x| (x - mean) * (x - mean)).sum();
    (of.len() > 1).then(|| (squares / (count - 1.0)).sqrt())
}

/// Between the two nearest in proportion.
fn quantile(sorted: &[f64], part: f64) -> Option<f64> {
    let place = part * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    Some(below + (above - below) * place.fract())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{normalised::Normalised, table::ErrorsDeg};

    #[test]
    fn a_range_of_seeds_is_a_simulation_each() {
        let names = each("sim:cruise?gnss=gaps&seed=3..5").unwrap().unwrap();
        let expected = [3, 4, 5].map(|seed| (seed, format!("sim:cruise?gnss=gaps&seed={seed}")));
        assert_eq!(names, expected);
        for one in ["sim:s1", "sim:s1?seed=4", "seed=1..3.csv", "flight?seed=1..2"] {
            assert_eq!(each(one).unwrap(), None, "{one}");
        }
        for bad in ["sim:s1?seed=5..3", "sim:s1?seed=1..10001", "sim:s1?seed=a..3", "sim:s1?seed=1.."] {
            assert_eq!(each(bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }

    #[test]
    fn the_spread_is_what_a_hand_computes() {
        let score = |deg: f64| TrialScore {
            name: String::new(),
            error: Errors {
                attitude: ErrorsDeg { total: Some(deg), heading: Some(2.0 * deg), inclination: None },
                drift_deg_min: Some(3.0 - deg),
                ..Errors::default()
            },
            heading_is_known: true,
            normalised: Normalised::default(),
            deviations: Deviations::default(),
            scored: 2,
            ticks: 3,
            ns_per_update: None,
            spread: None,
        };
        let of: Vec<_> =
            [(7, 1.0), (8, 5.0), (9, 2.0), (10, 4.0), (11, 3.0)].map(|(seed, deg)| (seed, score(deg))).into();
        let spread = spread(&of).unwrap();
        assert_eq!((spread.seeds, spread.worst_seed, spread.worst.attitude.total), (5, 8, Some(5.0)));
        assert!(
            (spread.sd.attitude.total.unwrap() - 2.5f64.sqrt()).abs() < 1e-15
                && spread.sd.attitude.inclination.is_none()
        );
        let [least, middle, most] = spread.quantiles.map(|errors| errors.attitude.heading.unwrap());
        assert!((least - 2.4).abs() < 1e-12 && middle == 6.0 && (most - 9.6).abs() < 1e-12);
        assert_eq!(joined("all", &of).error.drift_deg_min, Some(1.2), "the mean size");
        assert!(spread.quantiles[1].drift_deg_min == Some(0.0) && spread.quantiles[0].drift_deg_min < Some(0.0));
        let worst: Vec<_> = spread.worst_seed_of.into_iter().collect();
        assert_eq!(worst, [("drift_deg_min", 8), ("heading", 8), ("total", 8)]);
        // Where headings are counted from nowhere the worst is that of the largest inclination.
        let arbitrary = |inclination: f64| TrialScore {
            heading_is_known: false,
            error: Errors {
                attitude: ErrorsDeg { inclination: Some(inclination), ..ErrorsDeg::default() },
                ..Errors::default()
            },
            ..score(1.0)
        };
        let of: Vec<_> = [(1, 0.2), (2, 0.7), (3, 0.5)].map(|(seed, deg)| (seed, arbitrary(deg))).into();
        assert_eq!(super::spread(&of).unwrap().worst_seed, 2);
    }
}
