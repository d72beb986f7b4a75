//! A simulation repeated with many seeds, and the spread of its errors.
//!
//! Input: the name of a simulation with `seed=A..B`.
//!
//! Output: one name per seed, and mean, standard deviation and quantiles of the errors.
//!
//! Failure: a range that is empty or too long is rejected.

use crate::{
    ScoreError,
    normalised::RatioHistograms,
    recommendation::ranking_error,
    table::{Errors, QUANTILES, Spread, TrialScore},
};

/// Maximum number of seeds for one simulation.
pub const MAX_SEEDS: u64 = 10_000;

/// Expands a seed range into one simulation per seed; `None` if the name contains no range.
///
/// # Errors
///
/// Returns [`ScoreError::InvalidSeedRange`] if the range is malformed, empty or longer than
/// [`MAX_SEEDS`].
pub fn expand(text: &str) -> Result<Option<Vec<(u64, String)>>, ScoreError> {
    let Some((name, query)) = text.split_once('?').filter(|(name, _)| name.starts_with("sim:")) else {
        return Ok(None);
    };
    let range = |pair: &str| pair.strip_prefix("seed=")?.split_once("..").map(|(a, b)| (a.to_owned(), b.to_owned()));
    let Some((first, last)) = query.split('&').find_map(range) else { return Ok(None) };
    let invalid = || ScoreError::InvalidSeedRange { max: MAX_SEEDS, text: text.into() };
    let (first, last): (u64, u64) = first.parse().ok().zip(last.parse().ok()).ok_or_else(invalid)?;
    if last.checked_sub(first).is_none_or(|more| more >= MAX_SEEDS) {
        return Err(invalid());
    }
    let with_seed = |seed: u64| {
        let pairs =
            query.split('&').map(|pair| if range(pair).is_some() { format!("seed={seed}") } else { pair.into() });
        format!("{name}?{}", pairs.collect::<Vec<_>>().join("&"))
    };
    Ok(Some((first..=last).map(|seed| (seed, with_seed(seed))).collect()))
}

/// Merges the scores of all seeds into the score of one trial called `name`.
pub fn merge(name: &str, scores: &[(u64, TrialScore)]) -> TrialScore {
    let mut ratios = RatioHistograms::default();
    scores.iter().for_each(|(_, score)| ratios.merge(&score.ratios));
    TrialScore {
        name: name.into(),
        error: Errors::mean(&scores.iter().map(|(_, score)| score.error).collect::<Vec<_>>()),
        heading_is_known: scores.iter().all(|(_, score)| score.heading_is_known),
        normalised: ratios.quantiles(),
        ratios,
        scored: scores.iter().map(|(_, score)| score.scored).sum(),
        ticks: scores.iter().map(|(_, score)| score.ticks).sum(),
        ns_per_update: scores.iter().find_map(|(_, score)| score.ns_per_update),
        spread: spread(scores),
    }
}

fn spread(scores: &[(u64, TrialScore)]) -> Option<Spread> {
    // An error without a mean has no spread either. An example is the heading error if the heading
    // is unknown for one seed.
    let has_mean =
        Errors::mean(&scores.iter().map(|(_, score)| score.error).collect::<Vec<_>>()).values().map(|it| it.is_some());
    let (_, ranking) = ranking_error(scores.iter().all(|(_, score)| score.heading_is_known));
    let error = |score: &TrialScore| ranking(&score.error.attitude).unwrap_or(f64::NEG_INFINITY);
    let (worst_seed, worst) = scores.iter().max_by(|(_, a), (_, b)| error(a).total_cmp(&error(b)))?;
    let sorted: [Vec<f64>; _] = std::array::from_fn(|at| {
        let mut sorted: Vec<f64> =
            scores.iter().filter(|_| has_mean[at]).filter_map(|(_, score)| score.error.values()[at]).collect();
        sorted.sort_by(f64::total_cmp);
        sorted
    });
    let errors = |of: &dyn Fn(&[f64]) -> Option<f64>| Errors::from_values(sorted.each_ref().map(|sorted| of(sorted)));
    let worst_of = |(at, name): (usize, &'static str)| {
        let known = scores
            .iter()
            .filter(|_| has_mean[at])
            .filter_map(|(seed, score)| Some((seed, score.error.values()[at]?.abs())));
        let (seed, _) = known.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        Some((name, *seed))
    };
    Some(Spread {
        seeds: scores.len() as u64,
        sd: errors(&standard_deviation),
        quantiles: QUANTILES.map(|probability| errors(&|sorted| quantile(sorted, probability))),
        worst_seed: *worst_seed,
        worst: worst.error,
        worst_seed_by_error: Errors::NAMES.into_iter().enumerate().filter_map(worst_of).collect(),
    })
}

/// Returns the sample standard deviation; `None` for fewer than two values.
fn standard_deviation(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
    (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt())
}

/// Returns a quantile by linear interpolation between the neighbouring values.
fn quantile(sorted: &[f64], probability: f64) -> Option<f64> {
    let rank = probability * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    Some(below + (above - below) * rank.fract())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{normalised::NormalisedErrors, table::ErrorsDeg};

    #[test]
    fn seed_range_expands_to_one_simulation_per_seed() {
        let names = expand("sim:cruise?gnss=gaps&seed=3..5").unwrap().unwrap();
        let expected = [3, 4, 5].map(|seed| (seed, format!("sim:cruise?gnss=gaps&seed={seed}")));
        assert_eq!(names, expected);
        for one in ["sim:s1", "sim:s1?seed=4", "seed=1..3.csv", "flight?seed=1..2"] {
            assert_eq!(expand(one).unwrap(), None, "{one}");
        }
        for bad in ["sim:s1?seed=5..3", "sim:s1?seed=1..10001", "sim:s1?seed=a..3", "sim:s1?seed=1.."] {
            assert_eq!(expand(bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }

    #[test]
    fn spread_matches_hand_computation() {
        let score = |deg: f64| TrialScore {
            name: "".into(),
            error: Errors {
                attitude: ErrorsDeg { total: Some(deg), heading: Some(2.0 * deg), inclination: None },
                drift_deg_min: Some(3.0 - deg),
                ..Errors::default()
            },
            heading_is_known: true,
            normalised: NormalisedErrors::default(),
            ratios: RatioHistograms::default(),
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
        assert_eq!(merge("all", &of).error.drift_deg_min, Some(1.2), "mean magnitude");
        assert!(spread.quantiles[1].drift_deg_min == Some(0.0) && spread.quantiles[0].drift_deg_min < Some(0.0));
        let worst: Vec<_> = spread.worst_seed_by_error.into_iter().collect();
        assert_eq!(worst, [("drift_deg_min", 8), ("heading", 8), ("total", 8)]);
        // If the zero direction of the heading is arbitrary, seeds are ranked by inclination error.
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
