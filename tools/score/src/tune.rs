//! Errors over the range of a setting, and the value with the smallest error.
//!
//! Input: a setting and a range.
//!
//! Output: for every chain with that setting, the errors over the range and the best value. A sweep
//! evaluates the range once; a search then refines it twice around the best value found so far.
//!
//! Time: sample timestamps.
//!
//! Failure: a setting that no stage has, values out of range, and trials without a reference are
//! rejected.

use std::{collections::HashSet, str::FromStr};

use launch::Launch;

use crate::{
    ScoreError,
    chain::StageChain,
    evaluation::{Evaluation, evaluate},
    recommendation::ranking_error,
    stages::{Setting, apply},
    table::{ErrorsDeg, Point, Sweep},
    trial::Trial,
};

/// Number of values in a sweep.
const SWEEP_VALUES: [u32; 1] = [25];
/// Number of values in each pass of a search: over the whole range, then around the best value.
const SEARCH_VALUES: [u32; 3] = [13, 7, 7];
/// Number of times that a search reads all trials.
pub(crate) const SEARCH_PASSES: u64 = SEARCH_VALUES.len() as u64;
/// Minimum ratio between the two ends of a range for its values to be spaced logarithmically.
const MIN_LOG_RATIO: f64 = 10.0;

/// A setting and its range, written as `key=a..b`, `slot.key=a..b` or `stage.key=a..b`.
#[derive(Debug, Clone, PartialEq)]
pub struct SettingRange {
    target: Option<String>,
    key: String,
    from: f64,
    to: f64,
}

impl FromStr for SettingRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "expected key=a..b, as in beta_rad_s=0.01..0.5";
        let (name, range) = text.split_once('=').ok_or(expected)?;
        let (from, to) = range.split_once("..").ok_or(expected)?;
        let end = |end: &str| format!("{name}={end}").parse::<Setting>();
        let (Setting { target, key, value: from }, to) = (end(from)?, end(to)?.value);
        if from < to { Ok(Self { target, key, from, to }) } else { Err(format!("{expected} with a below b")) }
    }
}

/// Evaluates a range and leaves the chains unchanged.
pub(crate) fn sweep(
    range: &SettingRange,
    trials: &[Trial],
    launches: &[Launch],
    report_progress: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Sweep>, ScoreError> {
    Ok(scan(range, &SWEEP_VALUES, trials, launches, report_progress)?.into_iter().map(|(_, sweep)| sweep).collect())
}

/// Searches for the best value and applies it to the chains that have the setting.
pub(crate) fn search(
    range: &SettingRange,
    trials: &[Trial],
    launches: &mut [Launch],
    report_progress: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Sweep>, ScoreError> {
    let found = scan(range, &SEARCH_VALUES, trials, launches, report_progress)?;
    for (index, sweep) in &found {
        apply(&range.setting(sweep.best.value), std::slice::from_mut(&mut launches[*index]))?;
    }
    Ok(found.into_iter().map(|(_, sweep)| sweep).collect())
}

/// Evaluates the range in one or more passes.
///
/// Returns the index and the result of each chain that has the setting.
fn scan(
    range: &SettingRange,
    value_counts: &[u32],
    trials: &[Trial],
    launches: &[Launch],
    report_progress: &(dyn Fn(u64) + Sync),
) -> Result<Vec<(usize, Sweep)>, ScoreError> {
    if trials.iter().all(|trial| !trial.has_reference) {
        return Err(ScoreError::NoReferenceForTuning { key: range.key.clone() });
    }
    // Both ends are validated before any trial is read.
    let mut chains = Vec::new();
    for value in [range.from, range.to] {
        chains = range.affected_chains(launches, value)?;
    }
    let mut tried: Vec<Vec<(f64, Evaluation)>> = vec![Vec::new(); chains.len()];
    for (pass, count) in value_counts.iter().copied().enumerate() {
        let mut candidates = Vec::new();
        for (chain, tried) in chains.iter().zip(&tried) {
            let (from, to) = if pass == 0 { (range.from, range.to) } else { around_best(tried) };
            let before = [chain.before].into_iter().filter(|_| pass == 0);
            let mut known: HashSet<u64> = tried.iter().map(|(value, _)| value.to_bits()).collect();
            let values = values(from, to, count).chain(before).filter(|value| known.insert(value.to_bits()));
            candidates.extend(values.map(|value| (chain.index, value)));
        }
        let candidate_launches = candidates.iter().map(|(index, value)| {
            let mut launch = [launches[*index].clone()];
            apply(&range.setting(*value), &mut launch)?;
            let [launch] = launch;
            Ok(launch)
        });
        let candidate_launches = candidate_launches.collect::<Result<Vec<_>, ScoreError>>()?;
        let evaluations = evaluate(trials, &candidate_launches, report_progress)?;
        for ((index, value), evaluation) in candidates.into_iter().zip(evaluations) {
            if let Some(at) = chains.iter().position(|chain| chain.index == index) {
                tried[at].push((value, evaluation));
            }
        }
        tried.iter_mut().for_each(|tried| tried.sort_by(|a, b| a.0.total_cmp(&b.0)));
    }
    chains.iter().zip(tried).map(|(chain, tried)| Ok((chain.index, chain.sweep(range, &tried, launches)?))).collect()
}

/// Chain that has the parameter to tune.
struct TunedChain {
    index: usize,
    setting: String,
    unit: &'static str,
    before: f64,
}

impl SettingRange {
    fn setting(&self, value: f64) -> Setting {
        Setting { target: self.target.clone(), key: self.key.clone(), value }
    }

    /// Returns the chains in which the value can be set.
    fn affected_chains(&self, launches: &[Launch], value: f64) -> Result<Vec<TunedChain>, ScoreError> {
        let mut changed = launches.to_vec();
        apply(&self.setting(value), &mut changed)?;
        let mut chains = Vec::new();
        for (index, launch) in changed.iter().enumerate() {
            for (slot, stage, parameters) in StageChain::from_launch(launch)?.parameters() {
                let set = |launch: &Launch| launch.stage(slot).set.get(&self.key).copied();
                let is_target = self.target.as_ref().is_none_or(|target| target == slot.name() || target == stage);
                let parameter = parameters.iter().find(|parameter| parameter.name == self.key && is_target);
                if let Some(parameter) = parameter.filter(|_| set(launch) == Some(value)) {
                    chains.push(TunedChain {
                        index,
                        setting: format!("{slot}.{}", self.key),
                        unit: parameter.unit,
                        before: set(&launches[index]).unwrap_or(parameter.default),
                    });
                }
            }
        }
        Ok(chains)
    }
}

impl TunedChain {
    fn sweep(
        &self,
        range: &SettingRange,
        tried: &[(f64, Evaluation)],
        launches: &[Launch],
    ) -> Result<Sweep, ScoreError> {
        let (name, ranked_by) = ranking(tried);
        let point = |(value, evaluation): &(f64, Evaluation)| {
            let errors = evaluation.mean;
            ranked_by(&errors.attitude).map(|error_deg| Point { value: *value, error_deg, errors })
        };
        let curve: Vec<_> = tried.iter().filter_map(point).collect();
        let no_reference = || ScoreError::NoReferenceForTuning { key: range.key.clone() };
        let best = *curve.iter().min_by(|a, b| a.error_deg.total_cmp(&b.error_deg)).ok_or_else(no_reference)?;
        let before = *curve.iter().find(|point| point.value == self.before).ok_or_else(no_reference)?;
        Ok(Sweep {
            fuser: launches[self.index].fuser.stage.clone(),
            setting: self.setting.clone(),
            unit: self.unit,
            objective: name,
            before,
            best,
            at_range_end: best.value == range.from || best.value == range.to,
            curve,
        })
    }
}

/// Returns the error by which the tried values are ranked, with its name.
fn ranking(tried: &[(f64, Evaluation)]) -> (&'static str, fn(&ErrorsDeg) -> Option<f64>) {
    ranking_error(tried.iter().all(|(_, evaluation)| evaluation.heading_is_known))
}

/// Returns the nearest tried values below and above the best value. At an end of the range, the
/// best value itself replaces the missing neighbour.
fn around_best(tried: &[(f64, Evaluation)]) -> (f64, f64) {
    let (_, ranked_by) = ranking(tried);
    let error = |i: usize| ranked_by(&tried[i].1.mean.attitude).unwrap_or(f64::INFINITY);
    let best = (0..tried.len()).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap_or_default();
    (tried[best.saturating_sub(1)].0, tried[(best + 1).min(tried.len() - 1)].0)
}

/// Returns `true` if a range is wide enough for logarithmic spacing.
pub(crate) fn is_log_range(from: f64, to: f64) -> bool {
    from > 0.0 && to / from >= MIN_LOG_RATIO
}

/// Returns `count` values from one end to the other, spaced linearly or, for a wide range,
/// logarithmically.
fn values(from: f64, to: f64, count: u32) -> impl Iterator<Item = f64> {
    let is_log = is_log_range(from, to);
    (0..count).map(move |i| {
        let share = f64::from(i) / f64::from(count - 1);
        match i {
            0 => from,
            _ if i == count - 1 => to,
            // Rounding to four significant digits keeps the values readable.
            _ if is_log => round(from * (to / from).powf(share), from, to),
            _ => round(from + (to - from) * share, from, to),
        }
    })
}

fn round(value: f64, from: f64, to: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value).clamp(from, to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Errors;

    #[test]
    fn setting_range_is_parsed() {
        let tune: SettingRange = "fuser.beta_rad_s=0.01..5e-1".parse().unwrap();
        assert_eq!(
            (tune.target.as_deref(), tune.key.as_str(), tune.from, tune.to),
            (Some("fuser"), "beta_rad_s", 0.01, 0.5)
        );
        for bad in ["beta", "beta=1", "beta=1..x", "beta=2..1", "beta=1..1", "beta=nan..1"] {
            assert!(bad.parse::<SettingRange>().is_err(), "{bad}");
        }
    }

    #[test]
    fn wide_range_is_logarithmic_and_includes_both_ends() {
        let logarithmic: Vec<_> = values(0.01, 1.0, 5).collect();
        assert_eq!(logarithmic, [0.01, 0.03162, 0.1, 0.3162, 1.0]);
        assert_eq!(values(-1.0, 1.0, 5).collect::<Vec<_>>(), [-1.0, -0.5, 0.0, 0.5, 1.0]);
    }

    #[test]
    fn refinement_spans_neighbours_of_best_value() {
        let errors = |deg: f64| Evaluation {
            mean: Errors {
                attitude: crate::table::ErrorsDeg { total: Some(deg), heading: Some(deg), inclination: Some(-deg) },
                ..Errors::default()
            },
            heading_is_known: true,
        };
        let tried = [(1.0, errors(3.0)), (2.0, errors(1.0)), (4.0, errors(2.0))];
        assert_eq!(around_best(&tried), (1.0, 4.0));
        assert_eq!(around_best(&tried[1..]), (2.0, 4.0), "at an end of the range");
    }
}
