//! The scores as tables that people read.
//!
//! Input: the scores. Output: lines of columns. Time: none. Failure: none; what is not known is a dash, a heading from nowhere `arb.`.

use crate::{
    normalised::Quantiles,
    seeds::{QUANTILES, Spread},
    table::{ERRORS, Errors, Scores, StageScore, TrialScore},
};

/// The first columns are of words.
const WORDS: usize = 2;
/// Columns of numbers are at least as wide.
const MIN_WIDTH: usize = 9;

/// Total, heading, inclination and the time of an update.
pub(crate) fn errors(scores: &Scores) -> String {
    let head = ["RMSE, degrees", "fuser", "total", "heading", "inclination", "ns/update"];
    let line = |name: &str, fuser: &str, errors: &Errors, is_known: bool, ns: Option<f64>| {
        let attitude = errors.attitude;
        let (total, heading) = match attitude.inclination {
            Some(_) if !is_known => (number(None, 3), "arb.".into()),
            _ => (number(attitude.total, 3), number(attitude.heading, 3)),
        };
        vec![name.into(), fuser.into(), total, heading, number(attitude.inclination, 3), number(ns, 0)]
    };
    let of_trial = |name: &str, stage: &StageScore, trial: &TrialScore| {
        let own = line(name, &stage.fuser, &trial.error, trial.heading_is_known, trial.ns_per_update);
        let spread = trial.spread.iter().flat_map(labelled);
        let spread = spread.map(|(label, errors)| line(&label, "", &errors, trial.heading_is_known, None));
        [own].into_iter().chain(spread).collect()
    };
    let mean = |name: &str, stage: &StageScore| {
        line(name, &stage.fuser, &stage.mean, stage.heading_is_known(), stage.ns_per_update)
    };
    aligned(&head, &rows(scores, of_trial, mean))
}

/// Every error but those of the whole attitude.
pub(crate) fn all_errors(scores: &Scores) -> String {
    let head = [
        "RMSE, and drift",
        "fuser",
        "roll, °",
        "pitch, °",
        "yaw, °",
        "course, °",
        "bias, °/s",
        "drift, °/min",
        "at end, °",
    ];
    let line = |name: &str, fuser: &str, values: [String; ERRORS]| {
        let [_, _, _, of_angles @ ..] = values;
        [name.into(), fuser.into()].into_iter().chain(of_angles).collect::<Vec<String>>()
    };
    let numbers = |errors: &Errors| {
        let mut at = Errors::NAMES.into_iter();
        errors.each().map(|value| number(value, if at.next() == Some("gyro_bias_deg_s") { 4 } else { 3 }))
    };
    let of_trial = |name: &str, stage: &StageScore, trial: &TrialScore| {
        let mut lines = vec![line(name, &stage.fuser, numbers(&trial.error))];
        if let Some(spread) = &trial.spread {
            lines.extend(labelled(spread).into_iter().map(|(label, errors)| line(&label, "", numbers(&errors))));
            let seed = |name| spread.worst_seed_of.get(name).map_or_else(|| number(None, 0), u64::to_string);
            lines.push(line("  its worst seed", "", Errors::NAMES.map(seed)));
        }
        lines
    };
    aligned(&head, &rows(scores, of_trial, |name, stage| line(name, &stage.fuser, numbers(&stage.mean))))
}

/// Errors over their own standard deviations.
pub(crate) fn normalised(scores: &Scores) -> String {
    let head = [
        "error / own deviation / ideal",
        "fuser",
        "incl. 68 %",
        "incl. 95 %",
        "head. 68 %",
        "head. 95 %",
        "course 68 %",
        "course 95 %",
    ];
    let line = |name: &str, fuser: &str, of: &crate::normalised::Normalised| {
        let told = |of: &Option<Quantiles>| [0, 1].map(|at| number(of.map(|of| of.over_ideal[at]), 2));
        let numbers = [&of.inclination, &of.heading, &of.course].into_iter().flat_map(told);
        [name.into(), fuser.into()].into_iter().chain(numbers).collect::<Vec<String>>()
    };
    let of_trial =
        |name: &str, stage: &StageScore, trial: &TrialScore| vec![line(name, &stage.fuser, &trial.normalised)];
    let rows = rows(scores, of_trial, |_, stage| line("all samples", &stage.fuser, &stage.normalised));
    aligned(&head, &rows)
}

/// How far the headings that are counted from nowhere drift, a line for each chain of stages.
pub(crate) fn drifts(scores: &Scores) -> Vec<String> {
    let of = |stage: &StageScore| {
        let (deg_min, end_deg) = stage.mean.drift_deg_min.zip(stage.mean.drift_end_deg)?;
        let known = stage.trials.iter().filter(|trial| trial.error.drift_end_deg.is_some());
        let runs = known.map(|trial| trial.spread.as_ref().map_or(1, |spread| spread.seeds)).sum();
        let (deg_min, end_deg, on_average) = match &stage.trials[..] {
            [one] if one.spread.is_none() => (one.error.drift_deg_min?, one.error.drift_end_deg?, String::new()),
            _ => (deg_min, end_deg, format!(", mean size over {}", launch::pluralize(runs, "run"))),
        };
        let sign = if on_average.is_empty() { "+" } else { "" };
        let signed = |value: f64, digits: usize| {
            if sign.is_empty() { format!("{value:.digits$}") } else { format!("{value:+.digits$}") }
        };
        Some(format!(
            "{}: no heading is known (arb.); it drifts by {}°/min, {}° at the end{on_average}",
            stage.fuser,
            signed(deg_min, 3),
            signed(end_deg, 2)
        ))
    };
    scores.stages.iter().filter_map(of).collect()
}

/// A number, or a dash.
pub(crate) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("—".into(), |value| format!("{value:.digits$}"))
}

/// The lines of each trial under one another, and of the means where there is more than one.
fn rows(
    scores: &Scores,
    of_trial: impl Fn(&str, &StageScore, &TrialScore) -> Vec<Vec<String>>,
    mean: impl Fn(&str, &StageScore) -> Vec<String>,
) -> Vec<Vec<String>> {
    let Some(first) = scores.stages.first() else { return Vec::new() };
    let mut rows = Vec::new();
    for (index, trial) in first.trials.iter().enumerate() {
        let mut name = trial.name.as_str();
        for stage in &scores.stages {
            rows.extend(stage.trials.get(index).into_iter().flat_map(|trial| of_trial(name, stage, trial)));
            name = "";
        }
    }
    let mut name = "mean";
    for stage in scores.stages.iter().filter(|_| first.trials.len() > 1) {
        rows.push(mean(name, stage));
        name = "";
    }
    rows
}

/// Words to the left, numbers to the right.
fn aligned(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        let least = if column < WORDS { 0 } else { MIN_WIDTH };
        cells.chain([head[column].chars().count()]).max().unwrap_or(0).max(least)
    };
    let widths: Vec<_> = (0..head.len()).map(width).collect();
    let head = head.iter().map(ToString::to_string).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column < WORDS { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        cells.collect::<Vec<_>>().join("  ")
    };
    [&head].into_iter().chain(rows).map(line).collect::<Vec<_>>().join("\n")
}

/// The lines of a spread under its mean.
fn labelled(spread: &Spread) -> Vec<(String, Errors)> {
    let quantiles =
        QUANTILES.iter().zip(spread.quantiles).map(|(part, errors)| (format!("  {} %", part * 100.0), errors));
    let worst = (format!("  worst: seed {}", spread.worst_seed), spread.worst);
    [("  deviation".to_owned(), spread.sd)].into_iter().chain(quantiles).chain([worst]).collect()
}
