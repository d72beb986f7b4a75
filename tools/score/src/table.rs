//! The scores, for people and for scripts.

use std::{collections::BTreeMap, fmt};

use attitude::metrics::AttitudeError;
use launch::Launch;
use serde::Serialize;

use crate::{
    normalised::{Deviations, Normalised},
    overlay::Difference,
    seeds::Spread,
    text,
    tune::Sweep,
    verdict::Verdict,
};

/// The scores of every chain of stages.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Scores {
    /// One for each fuser.
    pub stages: Vec<StageScore>,
    /// What is to be said of the trials before their scores are believed.
    pub warnings: Vec<Warning>,
    /// What was found over the ranges of settings; the scores are with the value before.
    pub swept: Vec<Sweep>,
    /// What a search for the best value of a setting has found; the scores are with that value.
    pub tuned: Vec<Sweep>,
    /// How far the stages are apart over the trials without a reference.
    pub differences: Vec<Difference>,
    /// Which stage and setting to choose, where there is a choice.
    pub choice: Option<Verdict>,
    /// People are to be told every error, too.
    #[serde(skip)]
    pub all_errors: bool,
}

/// What is to be said of a trial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Warning {
    /// The trial.
    pub trial: String,
    /// What was found, with the remedies, for people.
    pub text: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "warning: {}: {}", self.trial, self.text)
    }
}

/// The scores of one chain of stages.
#[derive(Debug, Clone, Serialize)]
pub struct StageScore {
    /// The stage of the slot `fuser`.
    pub fuser: String,
    /// The stage of the slot `gyro`.
    pub gyro: String,
    /// The stage of the slot `accel`.
    pub accel: String,
    /// The stage of the slot `course`.
    pub course: String,
    /// What was set, as `slot.key`.
    pub settings: BTreeMap<String, f64>,
    /// Trial by trial.
    pub trials: Vec<TrialScore>,
    /// Mean of the trials that have a score.
    pub mean: Errors,
    /// Errors over their own standard deviations, of the samples of all trials.
    pub normalised: Normalised,
    /// Mean of the trials, ns.
    pub ns_per_update: Option<f64>,
}

/// The score of one trial.
#[derive(Debug, Clone, Serialize)]
pub struct TrialScore {
    /// Its name.
    pub name: String,
    /// Root mean square of the errors where they count.
    #[serde(flatten)]
    pub error: Errors,
    /// The heading is counted from north in the end; where it is not, total and heading mean nothing and are `None`.
    pub heading_is_known: bool,
    /// Errors over their own standard deviations.
    pub normalised: Normalised,
    /// What that was told from.
    #[serde(skip)]
    pub deviations: Deviations,
    /// Samples that count.
    pub scored: u64,
    /// Samples.
    pub ticks: u64,
    /// Time from a sample to the fused attitude, ns.
    pub ns_per_update: Option<f64>,
    /// Over the seeds of a simulation with many, whose mean the errors are then.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread: Option<Spread>,
}

/// Every error of a chain of stages; `None` where there is no truth, or where it means nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Errors {
    /// Of the whole attitude.
    #[serde(flatten)]
    pub attitude: ErrorsDeg,
    /// Of roll, degrees.
    pub roll: Option<f64>,
    /// Of pitch, degrees.
    pub pitch: Option<f64>,
    /// Of yaw, degrees; `None` where it is counted from nowhere.
    pub yaw: Option<f64>,
    /// Of the course as the course stage tells it, degrees; `None` where it is counted from nowhere.
    pub course: Option<f64>,
    /// Length of that of the gyro's bias, °/s; known in a simulation.
    pub gyro_bias_deg_s: Option<f64>,
    /// How fast a heading that is counted from nowhere drifts, °/min, counter-clockwise from above positive.
    pub drift_deg_min: Option<f64>,
    /// How far it has drifted in the end, degrees.
    pub drift_end_deg: Option<f64>,
}

/// How many errors there are.
pub(crate) const ERRORS: usize = 10;

impl Errors {
    /// Their names, as scripts read them.
    pub(crate) const NAMES: [&'static str; ERRORS] = [
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

    /// In the order of their names.
    pub(crate) fn each(&self) -> [Option<f64>; ERRORS] {
        let Self { attitude: ErrorsDeg { total, heading, inclination }, roll, pitch, yaw, course, .. } = *self;
        let Self { gyro_bias_deg_s, drift_deg_min, drift_end_deg, .. } = *self;
        [total, heading, inclination, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg]
    }

    pub(crate) fn of_each(values: [Option<f64>; ERRORS]) -> Self {
        let [total, heading, inclination, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg] =
            values;
        let attitude = ErrorsDeg { total, heading, inclination };
        Self { attitude, roll, pitch, yaw, course, gyro_bias_deg_s, drift_deg_min, drift_end_deg }
    }

    /// Of each the mean size, over those that have it; of total, heading and yaw none where one that has a score lacks them, so that a mean
    /// is of the same trials as that of the inclination beside it.
    pub(crate) fn mean(of: &[Self]) -> Self {
        let mean = |at: usize| {
            let known = || of.iter().filter_map(|errors| errors.each()[at]);
            let count = known().count();
            let scored = of.iter().filter(|errors| errors.attitude.inclination.is_some()).count();
            let is_of_all = !["total", "heading", "yaw"].contains(&Self::NAMES[at]) || count >= scored;
            (count > 0 && is_of_all).then(|| known().map(f64::abs).sum::<f64>() / count as f64)
        };
        Self::of_each(std::array::from_fn(mean))
    }
}

/// Errors in degrees; `None` where there is no reference.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ErrorsDeg {
    /// The whole turn.
    pub total: Option<f64>,
    /// About the vertical.
    pub heading: Option<f64>,
    /// Of the vertical.
    pub inclination: Option<f64>,
}

impl ErrorsDeg {
    pub(crate) fn of(error: Option<AttitudeError>) -> Self {
        Self {
            total: error.map(|error| error.total_deg),
            heading: error.map(|error| error.heading_deg),
            inclination: error.map(|error| error.inclination_deg),
        }
    }
}

impl StageScore {
    pub(crate) fn new(launch: &Launch) -> Self {
        let slots =
            [("gyro", &launch.gyro), ("accel", &launch.accel), ("fuser", &launch.fuser), ("course", &launch.course)];
        let settings = slots
            .iter()
            .flat_map(|(slot, filling)| filling.set.iter().map(move |(key, value)| (format!("{slot}.{key}"), *value)));
        Self {
            fuser: launch.fuser.stage.clone(),
            gyro: launch.gyro.stage.clone(),
            accel: launch.accel.stage.clone(),
            course: launch.course.stage.clone(),
            settings: settings.collect(),
            trials: Vec::new(),
            mean: Errors::default(),
            normalised: Normalised::default(),
            ns_per_update: None,
        }
    }

    /// The means of the trials.
    pub(crate) fn finish(&mut self) {
        self.mean = Errors::mean(&self.trials.iter().map(|trial| trial.error).collect::<Vec<_>>());
        let mut deviations = Deviations::default();
        self.trials.iter().for_each(|trial| deviations.add(&trial.deviations));
        self.normalised = deviations.told();
        let times: Vec<f64> = self.trials.iter().filter_map(|trial| trial.ns_per_update).collect();
        self.ns_per_update = (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64);
    }

    /// In every trial that has a score the heading is counted from north.
    pub(crate) fn heading_is_known(&self) -> bool {
        self.trials.iter().all(|trial| trial.heading_is_known || trial.scored == 0)
    }
}

impl Scores {
    /// The scores for scripts: one object on one line.
    pub fn json(&self) -> String {
        // Numbers, strings and lists always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl fmt::Display for Scores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", text::errors(self))?;
        if self.all_errors {
            write!(f, "\n\n{}\n\n{}", text::all_errors(self), text::normalised(self))?;
        }
        text::drifts(self).iter().try_for_each(|line| write!(f, "\n{line}"))?;
        for Difference { trial, from, to, rms } in &self.differences {
            let [total, heading, inclination] =
                [rms.total, rms.heading, rms.inclination].map(|deg| text::number(deg, 3));
            write!(
                f,
                "\n{trial}: {from} and {to} are apart by total {total}°, heading {heading}°, inclination {inclination}°"
            )?;
        }
        for Sweep { fuser, setting, unit, least_of, before, best, .. } in self.swept.iter().chain(&self.tuned) {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            write!(
                f,
                "\n{fuser}: {least_of} error {:.3}° with {setting} = {}{unit}, {:.3}° with {} as before",
                best.error_deg, best.value, before.error_deg, before.value
            )?;
        }
        match &self.choice {
            Some(choice) => write!(f, "\n{}", choice.text),
            None => Ok(()),
        }
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
            normalised: Normalised::default(),
            deviations: Deviations::default(),
            scored: 3,
            ticks: 5,
            ns_per_update: Some(100.0),
            spread: None,
        };
        let mut stage = StageScore::new(&Launch::default());
        stage.trials = vec![trial("one", Some(1.0)), trial("two", Some(2.0)), trial("no_truth", None)];
        stage.finish();
        Scores { stages: vec![stage], ..Scores::default() }
    }

    #[test]
    fn the_mean_is_over_the_trials_that_have_a_score() {
        let Scores { stages, .. } = scores();
        assert_eq!(stages[0].mean.attitude, ErrorsDeg { total: Some(1.5), heading: Some(1.5), inclination: Some(1.5) });
        assert_eq!(stages[0].ns_per_update, Some(100.0));
    }

    #[test]
    fn where_one_trial_knows_no_heading_the_mean_has_none() {
        let of = |total: Option<f64>, inclination: f64| {
            let attitude = ErrorsDeg { total, heading: total, inclination: Some(inclination) };
            Errors { attitude, yaw: total, roll: Some(1.0), ..Errors::default() }
        };
        let mean = Errors::mean(&[of(Some(3.0), 1.0), of(None, 2.0), Errors::default()]);
        assert_eq!(mean.attitude, ErrorsDeg { inclination: Some(1.5), ..ErrorsDeg::default() });
        assert_eq!((mean.yaw, mean.roll), (None, Some(1.0)));
    }

    #[test]
    fn what_is_not_known_is_null_for_scripts_and_a_dash_for_people() {
        let json: serde_json::Value = serde_json::from_str(&scores().json()).unwrap();
        assert_eq!(json.pointer("/stages/0/trials/2/total"), Some(&serde_json::Value::Null));
        assert_eq!(json.pointer("/stages/0/trials/0/total"), Some(&1.0.into()));
        let table = scores().to_string();
        assert!(table.lines().any(|line| line.starts_with("no_truth") && line.contains('—')), "{table}");
        let widths: Vec<_> = table.lines().map(|line| line.chars().count()).collect();
        assert!(widths.windows(2).all(|pair| pair[0] == pair[1]), "{table}");
    }
}
