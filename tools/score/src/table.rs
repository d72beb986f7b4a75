//! Scores of all chains, with their JSON and text output.

use std::{collections::BTreeMap, fmt};

use attitude::metrics::AttitudeError;
use foreign::ForeignText;
use launch::{Launch, Slot};
use serde::Serialize;

use crate::normalised::{NormalisedErrors, RatioHistograms};

/// Scores of all chains.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Scores {
    /// Scores of each chain, one per fuser, followed by those of the estimates from files.
    pub stages: Vec<StageScore>,
    /// Warnings about the input of the trials.
    pub warnings: Vec<TrialWarning>,
    /// Errors over the ranges of swept settings. The scores use the original values.
    pub swept: Vec<Sweep>,
    /// Results of searches for the best value of a setting. The scores use the best value.
    pub tuned: Vec<Sweep>,
    /// Differences between the chains on trials without a reference.
    pub differences: Vec<StageDifference>,
    /// Recommended stage and setting; `None` if there is nothing to choose from.
    pub recommendation: Option<Recommendation>,
    /// `true` if the text output contains the tables of all errors.
    #[serde(skip)]
    pub prints_all_errors: bool,
}

/// A warning about a trial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TrialWarning {
    /// Name of the trial.
    pub trial: ForeignText,
    /// Finding and remedy.
    pub text: String,
}

impl fmt::Display for TrialWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "warning: {}: {}", self.trial, self.text)
    }
}

/// Scores of one chain, or of an estimate from a file.
#[derive(Debug, Clone, Default, Serialize)]
pub struct StageScore {
    /// Stage of the slot `fuser`, or name of an estimate from a file.
    pub fuser: String,
    /// Stage of the slot `gyro`; `None` for an estimate from a file.
    pub gyro: Option<String>,
    /// Stage of the slot `accel`; `None` for an estimate from a file.
    pub accel: Option<String>,
    /// Stage of the slot `course`; `None` for an estimate from a file.
    pub course: Option<String>,
    /// Settings that differ from the defaults, as `slot.key`.
    pub settings: BTreeMap<String, f64>,
    /// Score of each trial.
    pub trials: Vec<TrialScore>,
    /// Mean over the trials with a score.
    pub mean: Errors,
    /// Normalised errors over the samples of all trials.
    pub normalised: NormalisedErrors,
    /// Mean CPU time per update over the trials, ns.
    pub ns_per_update: Option<f64>,
}

/// Score of one trial.
#[derive(Debug, Clone, Serialize)]
pub struct TrialScore {
    /// Name of the trial.
    pub name: ForeignText,
    /// Root mean square errors over the scored samples.
    #[serde(flatten)]
    pub error: Errors,
    /// `true` if the heading is known at the end. Otherwise, the total, heading and yaw errors are
    /// `None`.
    pub heading_is_known: bool,
    /// Normalised errors.
    pub normalised: NormalisedErrors,
    /// Histograms from which `normalised` was computed.
    #[serde(skip)]
    pub ratios: RatioHistograms,
    /// Number of scored samples.
    pub scored: u64,
    /// Number of samples.
    pub ticks: u64,
    /// CPU time per update, from a sample to the fused attitude, ns.
    pub ns_per_update: Option<f64>,
    /// Spread over the seeds of a simulation; the errors are then the means over the seeds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread: Option<Spread>,
}

/// Errors of a chain; `None` without a reference, or if the error is undefined.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Errors {
    /// Attitude errors.
    #[serde(flatten)]
    pub attitude: ErrorsDeg,
    /// Roll error, degrees.
    pub roll: Option<f64>,
    /// Pitch error, degrees.
    pub pitch: Option<f64>,
    /// Yaw error, degrees; `None` if the zero direction of the heading is arbitrary.
    pub yaw: Option<f64>,
    /// Error of the published course, degrees; `None` if the course reference is arbitrary.
    pub course: Option<f64>,
    /// Magnitude of the gyro bias error, °/s; known in simulations only.
    pub gyro_bias_deg_s: Option<f64>,
    /// Drift rate in °/min of a heading with an arbitrary zero direction, counter-clockwise seen
    /// from above.
    pub drift_deg_min: Option<f64>,
    /// Drift in degrees at the end of the trial, of a heading with an arbitrary zero direction.
    pub drift_end_deg: Option<f64>,
}

/// Probabilities of the reported quantiles.
pub const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];
/// Number of errors.
pub(crate) const ERROR_COUNT: usize = 10;

/// Root mean square difference between two chains over a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageDifference {
    /// Name of the trial.
    pub trial: ForeignText,
    /// Fuser of the first chain.
    pub from: String,
    /// Fuser of the other chain.
    pub to: String,
    /// Root mean square difference.
    #[serde(flatten)]
    pub rms: ErrorsDeg,
}

/// Spread of the errors over the seeds of a simulation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// Number of seeds.
    pub seeds: u64,
    /// Standard deviation of each error.
    pub sd: Errors,
    /// Errors that 5, 50 and 95 % of the seeds do not exceed.
    pub quantiles: [Errors; QUANTILES.len()],
    /// Seed with the largest total error. If the heading is unknown, seed with the largest
    /// inclination error.
    pub worst_seed: u64,
    /// Errors of the worst seed.
    pub worst: Errors,
    /// Seed with the largest magnitude of each known error, keyed by error name.
    pub worst_seed_by_error: BTreeMap<&'static str, u64>,
}

/// Result of a sweep or search for one chain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sweep {
    /// Fuser of the chain.
    pub fuser: String,
    /// Name of the setting, as `slot.key`.
    pub setting: String,
    /// Unit of the setting.
    pub unit: &'static str,
    /// Name of the minimised error: total, or inclination if the heading is unknown.
    pub objective: &'static str,
    /// Value before the sweep or search.
    pub before: Point,
    /// Value with the smallest error.
    pub best: Point,
    /// `true` if the best value is at an end of the range, so that a better one may lie beyond it.
    pub at_range_end: bool,
    /// Every value that was tried, in ascending order.
    pub curve: Vec<Point>,
}

/// A value of a setting and its errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// Value, in the unit of the setting.
    pub value: f64,
    /// Mean of the minimised RMSE over the trials, degrees.
    pub error_deg: f64,
    /// Mean of every error over the trials.
    #[serde(flatten)]
    pub errors: Errors,
}

/// Recommendation derived from the scores.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Recommendation {
    /// Best and second-best stage with their errors, as text.
    pub text: String,
    /// Sections of `launch.toml` that select the best stage; empty without a reference.
    pub launch: String,
}

impl Errors {
    /// Names of the errors in JSON.
    pub(crate) const NAMES: [&'static str; ERROR_COUNT] = [
        "total",
        "heading",
        "inclination",
        "roll",
        "pitch",
        "yaw",
        "course",
        "gyro_bias_deg_s",
        "drift_deg_min",
        "drift_end_deg",
    ];

    /// Returns the errors in the order of their names.
    pub(crate) fn values(&self) -> [Option<f64>; ERROR_COUNT] {
        let Self { attitude: ErrorsDeg { total, heading, inclination }, roll, pitch, yaw, course, .. } = *self;
        let Self { gyro_bias_deg_s, drift_deg_min, drift_end_deg, .. } = *self;
        [total, heading, inclination, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg]
    }

    pub(crate) fn from_values(values: [Option<f64>; ERROR_COUNT]) -> Self {
        let [total, heading, inclination, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg] =
            values;
        let attitude = ErrorsDeg { total, heading, inclination };
        Self { attitude, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg }
    }

    /// Returns the mean magnitude of each error over the trials that have it.
    ///
    /// The means of total, heading and yaw are `None` if a scored trial lacks the error. If
    /// present, they therefore cover the same trials as the mean inclination error.
    pub(crate) fn mean(all: &[Self]) -> Self {
        let mean = |at: usize| {
            let known = || all.iter().filter_map(|errors| errors.values()[at]);
            let count = known().count();
            let scored = all.iter().filter(|errors| errors.attitude.inclination.is_some()).count();
            let is_complete = !["total", "heading", "yaw"].contains(&Self::NAMES[at]) || count >= scored;
            (count > 0 && is_complete).then(|| known().map(f64::abs).sum::<f64>() / count as f64)
        };
        Self::from_values(std::array::from_fn(mean))
    }
}

/// Attitude errors, degrees; `None` without a reference.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ErrorsDeg {
    /// Angle of the total rotation between estimate and reference.
    pub total: Option<f64>,
    /// Rotation about the vertical.
    pub heading: Option<f64>,
    /// Angle between the estimated and the true vertical.
    pub inclination: Option<f64>,
}

impl ErrorsDeg {
    pub(crate) fn from_error(error: Option<AttitudeError>) -> Self {
        Self {
            total: error.map(|error| error.total_deg),
            heading: error.map(|error| error.heading_deg),
            inclination: error.map(|error| error.inclination_deg),
        }
    }
}

impl StageScore {
    pub(crate) fn new(launch: &Launch) -> Self {
        let settings = Slot::ALL
            .into_iter()
            .flat_map(|slot| launch.stage(slot).set.iter().map(move |(key, value)| (format!("{slot}.{key}"), *value)));
        Self {
            fuser: launch.fuser.stage.clone(),
            gyro: Some(launch.gyro.stage.clone()),
            accel: Some(launch.accel.stage.clone()),
            course: Some(launch.course.stage.clone()),
            settings: settings.collect(),
            ..Self::default()
        }
    }

    /// Creates an empty score for an estimate that is read from a file.
    pub(crate) fn from_estimate(name: &str) -> Self {
        Self { fuser: name.into(), ..Self::default() }
    }

    /// Computes the means over the trials.
    pub(crate) fn update_means(&mut self) {
        self.mean = Errors::mean(&self.trials.iter().map(|trial| trial.error).collect::<Vec<_>>());
        let mut ratios = RatioHistograms::default();
        self.trials.iter().for_each(|trial| ratios.merge(&trial.ratios));
        self.normalised = ratios.quantiles();
        let times: Vec<f64> = self.trials.iter().filter_map(|trial| trial.ns_per_update).collect();
        self.ns_per_update = (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64);
    }

    /// Returns `true` if the heading is known in every trial with a score.
    pub(crate) fn heading_is_known(&self) -> bool {
        self.trials.iter().all(|trial| trial.heading_is_known || trial.scored == 0)
    }
}

impl Scores {
    /// Returns the scores as one line of JSON.
    pub fn json(&self) -> String {
        // Serialisation of numbers, strings and lists cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores() -> Scores {
        let trial = |name: &str, deg: Option<f64>| TrialScore {
            name: name.into(),
            error: Errors { attitude: ErrorsDeg { total: deg, heading: deg, inclination: deg }, ..Errors::default() },
            heading_is_known: true,
            normalised: NormalisedErrors::default(),
            ratios: RatioHistograms::default(),
            scored: 3,
            ticks: 5,
            ns_per_update: Some(100.0),
            spread: None,
        };
        let mut stage = StageScore::new(&Launch::default());
        stage.trials = vec![trial("one", Some(1.0)), trial("two", Some(2.0)), trial("no_truth", None)];
        stage.update_means();
        Scores { stages: vec![stage], ..Scores::default() }
    }

    #[test]
    fn hostile_trial_name_is_escaped_except_in_json() {
        let trial = ForeignText::from("a\x1b[2J\nforged");
        let warning = TrialWarning { trial: trial.clone(), text: "no reference".into() };
        assert_eq!(warning.to_string(), r"warning: a\u{1b}[2J\nforged: no reference");
        let difference = StageDifference { trial, from: "wz".into(), to: "vqf".into(), rms: ErrorsDeg::default() };
        let scores = Scores { differences: vec![difference], ..Scores::default() };
        assert!(scores.to_string().contains(r"a\u{1b}[2J\nforged: vqf differs from wz"), "{scores}");
        assert_eq!(serde_json::to_value(&scores).unwrap()["differences"][0]["trial"], "a\x1b[2J\nforged");
    }

    #[test]
    fn mean_covers_scored_trials_only() {
        let Scores { stages, .. } = scores();
        assert_eq!(stages[0].mean.attitude, ErrorsDeg { total: Some(1.5), heading: Some(1.5), inclination: Some(1.5) });
        assert_eq!(stages[0].ns_per_update, Some(100.0));
    }

    #[test]
    fn mean_heading_unknown_if_unknown_in_one_trial() {
        let of = |total: Option<f64>, inclination: f64| {
            let attitude = ErrorsDeg { total, heading: total, inclination: Some(inclination) };
            Errors { attitude, yaw: total, roll: Some(1.0), ..Errors::default() }
        };
        let mean = Errors::mean(&[of(Some(3.0), 1.0), of(None, 2.0), Errors::default()]);
        assert_eq!(mean.attitude, ErrorsDeg { inclination: Some(1.5), ..ErrorsDeg::default() });
        assert_eq!((mean.yaw, mean.roll), (None, Some(1.0)));
    }

    #[test]
    fn unknown_errors_are_null_in_json_and_dash_in_table() {
        let json: serde_json::Value = serde_json::from_str(&scores().json()).unwrap();
        assert_eq!(json.pointer("/stages/0/trials/2/total"), Some(&serde_json::Value::Null));
        assert_eq!(json.pointer("/stages/0/trials/0/total"), Some(&1.0.into()));
        let table = scores().to_string();
        assert!(table.lines().any(|line| line.starts_with("no_truth") && line.contains('—')), "{table}");
        let widths: Vec<_> = table.lines().map(|line| line.chars().count()).collect();
        assert!(widths.windows(2).all(|pair| pair[0] == pair[1]), "{table}");
    }
}
