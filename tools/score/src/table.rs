//! The scores, for people and for scripts.

use std::{collections::BTreeMap, fmt};

use attitude::metrics::{Accuracy, AttitudeError};
use launch::Launch;
use serde::Serialize;

use crate::seeds::{QUANTILES, Spread};

/// The scores of every chain of stages.
#[derive(Debug, Clone, Serialize)]
pub struct Scores {
    /// One for each fuser.
    pub stages: Vec<StageScore>,
    /// What is to be said of the trials before their scores are believed.
    pub warnings: Vec<Warning>,
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
    pub mean: ErrorsDeg,
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
    pub error: ErrorsDeg,
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

    pub(crate) fn error(self) -> Option<AttitudeError> {
        let Self { total, heading, inclination } = self;
        Some(AttitudeError { total_deg: total?, heading_deg: heading?, inclination_deg: inclination? })
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
            mean: ErrorsDeg::default(),
            ns_per_update: None,
        }
    }

    /// The means of the trials.
    pub(crate) fn finish(&mut self) {
        self.mean = ErrorsDeg::of(Accuracy::mean(self.trials.iter().filter_map(|trial| trial.error.error())));
        let times: Vec<f64> = self.trials.iter().filter_map(|trial| trial.ns_per_update).collect();
        self.ns_per_update = (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64);
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
        let Some(first) = self.stages.first() else { return Ok(()) };
        let longest =
            |names: &mut dyn Iterator<Item = &String>| names.map(|name| name.chars().count()).max().unwrap_or(0);
        let wide = longest(&mut first.trials.iter().map(|trial| &trial.name)).max("RMSE, degrees".len());
        let fuser = longest(&mut self.stages.iter().map(|stage| &stage.fuser)).max("fuser".len());
        let number = |x: Option<f64>, digits: usize| x.map_or("—".into(), |x| format!("{x:.digits$}"));
        let line = |name: &str, stage: &str, error: &ErrorsDeg, ns: Option<f64>| {
            let [total, heading, inclination] =
                [error.total, error.heading, error.inclination].map(|deg| number(deg, 3));
            let ns = number(ns, 0);
            format!("{name:wide$}  {stage:fuser$}  {total:>9}  {heading:>9}  {inclination:>11}  {ns:>9}")
        };
        write!(
            f,
            "{:wide$}  {:fuser$}  {:>9}  {:>9}  {:>11}  {:>9}",
            "RMSE, degrees", "fuser", "total", "heading", "inclination", "ns/update"
        )?;
        for (index, trial) in first.trials.iter().enumerate() {
            let mut name = trial.name.as_str();
            for stage in &self.stages {
                let Some(trial) = stage.trials.get(index) else { continue };
                write!(f, "\n{}", line(name, &stage.fuser, &trial.error, trial.ns_per_update))?;
                for (label, errors) in trial.spread.iter().flat_map(labelled) {
                    write!(f, "\n{}", line(&label, "", &errors, None))?;
                }
                name = "";
            }
        }
        let mut name = "mean";
        for stage in self.stages.iter().filter(|_| first.trials.len() > 1) {
            write!(f, "\n{}", line(name, &stage.fuser, &stage.mean, stage.ns_per_update))?;
            name = "";
        }
        Ok(())
    }
}

/// The lines of a spread under its mean.
fn labelled(spread: &Spread) -> Vec<(String, ErrorsDeg)> {
    let quantiles =
        QUANTILES.iter().zip(spread.quantiles).map(|(part, errors)| (format!("  {} %", part * 100.0), errors));
    let worst = (format!("  worst: seed {}", spread.worst_seed), spread.worst);
    [("  deviation".to_owned(), spread.sd)].into_iter().chain(quantiles).chain([worst]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores() -> Scores {
        let trial = |name: &str, deg: Option<f64>| TrialScore {
            name: name.into(),
            error: ErrorsDeg { total: deg, heading: deg, inclination: deg },
            scored: 3,
            ticks: 5,
            ns_per_update: Some(100.0),
            spread: None,
        };
        let mut stage = StageScore::new(&Launch::default());
        stage.trials = vec![trial("one", Some(1.0)), trial("two", Some(2.0)), trial("no_truth", None)];
        stage.finish();
        Scores { stages: vec![stage], warnings: Vec::new() }
    }

    #[test]
    fn the_mean_is_over_the_trials_that_have_a_score() {
        let Scores { stages, .. } = scores();
        assert_eq!(stages[0].mean, ErrorsDeg { total: Some(1.5), heading: Some(1.5), inclination: Some(1.5) });
        assert_eq!(stages[0].ns_per_update, Some(100.0));
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
