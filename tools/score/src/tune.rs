//! The errors over the range of a setting, and the value that gives the least.
//!
//! Input: a setting and a range. Output: of every chain of stages that has it, the errors over the range and the best value. A sweep looks at the range as
//! a whole; a search then twice more around the best value so far. Time: the samples' own. Failure: a setting that no stage has, values that it
//! refuses, trials without a reference.

use std::{collections::HashSet, str::FromStr};

use launch::Launch;
use serde::Serialize;

use crate::{
    ScoreError,
    chain::Stages,
    run::{Found, errors_of},
    stages::{Setting, apply},
    table::{Errors, ErrorsDeg},
    trial::Trial,
    verdict::least_of,
};

/// Values over the range of a sweep.
const SWEEP: [u32; 1] = [25];
/// Values of a search over the range, and over each closer look.
const VALUES: [u32; 3] = [13, 7, 7];
/// Times the trials are read for a search.
pub(crate) const LOOKS: u64 = VALUES.len() as u64;
/// A range that goes this many times up is gone through by factors.
const BY_FACTORS_FROM: f64 = 10.0;

/// A setting and its range, as `key=a..b`, `slot.key=a..b` or `stage.key=a..b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    of: Option<String>,
    key: String,
    from: f64,
    to: f64,
}

impl FromStr for Range {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "expected key=a..b, as in beta_rad_s=0.01..0.5";
        let (place, range) = text.split_once('=').ok_or(expected)?;
        let (from, to) = range.split_once("..").ok_or(expected)?;
        let end = |end: &str| format!("{place}={end}").parse::<Setting>();
        let (Setting { of, key, value: from }, to) = (end(from)?, end(to)?.value);
        if from < to { Ok(Self { of, key, from, to }) } else { Err(format!("{expected} with a below b")) }
    }
}

/// What a sweep or a search has found of a chain of stages.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sweep {
    /// The fuser of the chain.
    pub fuser: String,
    /// The setting, as `slot.key`.
    pub setting: String,
    /// Its unit.
    pub unit: &'static str,
    /// Which error was to be least: total, or inclination where no heading is known.
    pub least_of: &'static str,
    /// The value before.
    pub before: Point,
    /// The best one.
    pub best: Point,
    /// The best one is at an end of the range: a better one may be beyond it.
    pub at_end: bool,
    /// Every value that was tried, in order.
    pub curve: Vec<Point>,
}

/// A value and its error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// The value, in the setting's unit.
    pub value: f64,
    /// Mean of the trials' RMSE that is to be least, degrees.
    pub error_deg: f64,
    /// Mean of every error.
    #[serde(flatten)]
    pub errors: Errors,
}

/// Goes through the range, and leaves the chains as they are.
pub(crate) fn sweep(
    range: &Range,
    trials: &[Trial],
    launches: &[Launch],
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Sweep>, ScoreError> {
    Ok(look(range, &SWEEP, trials, launches, tell)?.into_iter().map(|(_, sweep)| sweep).collect())
}

/// Searches, and gives the best value to the chains that have the setting.
pub(crate) fn search(
    range: &Range,
    trials: &[Trial],
    launches: &mut [Launch],
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Sweep>, ScoreError> {
    let found = look(range, &VALUES, trials, launches, tell)?;
    for (index, sweep) in &found {
        apply(&range.at(sweep.best.value), std::slice::from_mut(&mut launches[*index]))?;
    }
    Ok(found.into_iter().map(|(_, sweep)| sweep).collect())
}

/// The errors over the range of each chain that has the setting, with the chain's place.
fn look(
    range: &Range,
    looks: &[u32],
    trials: &[Trial],
    launches: &[Launch],
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Vec<(usize, Sweep)>, ScoreError> {
    if trials.iter().all(|trial| !trial.has_reference) {
        return Err(ScoreError::NothingToTuneBy { key: range.key.clone() });
    }
    // What is refused anywhere is refused before anything is read.
    let mut chains = Vec::new();
    for value in [range.from, range.to] {
        chains = range.chains(launches, value)?;
    }
    let mut tried: Vec<Vec<(f64, Found)>> = vec![Vec::new(); chains.len()];
    for (look, count) in looks.iter().copied().enumerate() {
        let mut candidates = Vec::new();
        for (chain, tried) in chains.iter().zip(&tried) {
            let (from, to) = if look == 0 { (range.from, range.to) } else { around_best(tried) };
            let before = [chain.before].into_iter().filter(|_| look == 0);
            let mut known: HashSet<u64> = tried.iter().map(|(value, _)| value.to_bits()).collect();
            let values = values(from, to, count).chain(before).filter(|value| known.insert(value.to_bits()));
            candidates.extend(values.map(|value| (chain.index, value)));
        }
        let tries = candidates.iter().map(|(index, value)| {
            let mut launch = [launches[*index].clone()];
            apply(&range.at(*value), &mut launch)?;
            let [launch] = launch;
            Ok(launch)
        });
        let tries = tries.collect::<Result<Vec<_>, ScoreError>>()?;
        let found = errors_of(trials, &tries, tell)?;
        for ((index, value), errors) in candidates.into_iter().zip(found) {
            if let Some(at) = chains.iter().position(|chain| chain.index == index) {
                tried[at].push((value, errors));
            }
        }
        tried.iter_mut().for_each(|tried| tried.sort_by(|a, b| a.0.total_cmp(&b.0)));
    }
    chains.iter().zip(tried).map(|(chain, tried)| Ok((chain.index, chain.swept(range, &tried, launches)?))).collect()
}

/// A chain of stages that has the setting.
struct Chain {
    index: usize,
    setting: String,
    unit: &'static str,
    before: f64,
}

impl Range {
    fn at(&self, value: f64) -> Setting {
        Setting { of: self.of.clone(), key: self.key.clone(), value }
    }

    /// The chains that take the value.
    fn chains(&self, launches: &[Launch], value: f64) -> Result<Vec<Chain>, ScoreError> {
        let mut with = launches.to_vec();
        apply(&self.at(value), &mut with)?;
        let mut chains = Vec::new();
        for (index, launch) in with.iter().enumerate() {
            for (slot, stage, parameters) in Stages::of(launch)?.parameters() {
                let set = |launch: &Launch| launch.stage(slot).and_then(|filling| filling.set.get(&self.key).copied());
                let meant = self.of.as_ref().is_none_or(|of| of == slot.name() || of == stage);
                let parameter = parameters.iter().find(|parameter| parameter.name == self.key && meant);
                if let Some(parameter) = parameter.filter(|_| set(launch) == Some(value)) {
                    chains.push(Chain {
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

impl Chain {
    fn swept(&self, range: &Range, tried: &[(f64, Found)], launches: &[Launch]) -> Result<Sweep, ScoreError> {
        let (name, ranked_by) = ranking(tried);
        let point = |(value, found): &(f64, Found)| {
            let errors = found.mean;
            ranked_by(&errors.attitude).map(|error_deg| Point { value: *value, error_deg, errors })
        };
        let curve: Vec<_> = tried.iter().filter_map(point).collect();
        let nothing = || ScoreError::NothingToTuneBy { key: range.key.clone() };
        let best = *curve.iter().min_by(|a, b| a.error_deg.total_cmp(&b.error_deg)).ok_or_else(nothing)?;
        let before = *curve.iter().find(|point| point.value == self.before).ok_or_else(nothing)?;
        Ok(Sweep {
            fuser: launches[self.index].fuser.stage.clone(),
            setting: self.setting.clone(),
            unit: self.unit,
            least_of: name,
            before,
            best,
            at_end: best.value == range.from || best.value == range.to,
            curve,
        })
    }
}

/// The error that is to be least of all that was tried, with its name.
fn ranking(tried: &[(f64, Found)]) -> (&'static str, fn(&ErrorsDeg) -> Option<f64>) {
    least_of(tried.iter().all(|(_, found)| found.heading_is_known))
}

/// Between the neighbours of the best value.
fn around_best(tried: &[(f64, Found)]) -> (f64, f64) {
    let (_, ranked_by) = ranking(tried);
    let error = |i: usize| ranked_by(&tried[i].1.mean.attitude).unwrap_or(f64::INFINITY);
    let best = (0..tried.len()).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap_or_default();
    (tried[best.saturating_sub(1)].0, tried[(best + 1).min(tried.len() - 1)].0)
}

/// So wide a range is gone through by factors, and drawn so.
pub(crate) fn goes_by_factors(from: f64, to: f64) -> bool {
    from > 0.0 && to / from >= BY_FACTORS_FROM
}

/// So many values from one to the other, by steps, or by factors over a wide range.
fn values(from: f64, to: f64, count: u32) -> impl Iterator<Item = f64> {
    let by_factors = goes_by_factors(from, to);
    (0..count).map(move |i| {
        let share = f64::from(i) / f64::from(count - 1);
        match i {
            0 => from,
            _ if i == count - 1 => to,
            // Digits that people read: three are more than a setting needs.
            _ if by_factors => rounded(from * (to / from).powf(share), from, to),
            _ => rounded(from + (to - from) * share, from, to),
        }
    })
}

fn rounded(value: f64, from: f64, to: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value).clamp(from, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_read_as_people_write_it() {
        let tune: Range = "fuser.beta_rad_s=0.01..5e-1".parse().unwrap();
        assert_eq!(
            (tune.of.as_deref(), tune.key.as_str(), tune.from, tune.to),
            (Some("fuser"), "beta_rad_s", 0.01, 0.5)
        );
        for bad in ["beta", "beta=1", "beta=1..x", "beta=2..1", "beta=1..1", "beta=nan..1"] {
            assert!(bad.parse::<Range>().is_err(), "{bad}");
        }
    }

    #[test]
    fn a_wide_range_is_gone_through_by_factors_and_both_ends_are_tried() {
        let of: Vec<_> = values(0.01, 1.0, 5).collect();
        assert_eq!(of, [0.01, 0.03162, 0.1, 0.3162, 1.0]);
        assert_eq!(values(-1.0, 1.0, 5).collect::<Vec<_>>(), [-1.0, -0.5, 0.0, 0.5, 1.0]);
    }

    #[test]
    fn a_closer_look_is_between_the_neighbours_of_the_best() {
        let errors = |deg: f64| Found {
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
