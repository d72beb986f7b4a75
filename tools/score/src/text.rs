//! The scores as text tables.
//!
//! Input: the scores.
//!
//! Output: lines of aligned columns. Unknown values are dashes; `arb.` marks a heading with an
//! arbitrary zero direction.

use std::fmt;

use crate::{
    normalised::RatioQuantiles,
    table::{ERROR_COUNT, Errors, QUANTILES, Scores, Spread, StageDifference, StageScore, Sweep, TrialScore},
};

/// Number of text columns at the left of each table.
const TEXT_COLUMNS: usize = 2;
/// Minimum width of a number column, characters.
const MIN_NUMBER_WIDTH: usize = 9;

impl fmt::Display for Scores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", errors(self))?;
        if self.prints_all_errors {
            write!(f, "\n\n{}\n\n{}", all_errors(self), normalised(self))?;
        }
        drifts(self).iter().try_for_each(|line| write!(f, "\n{line}"))?;
        for StageDifference { trial, from, to, rms } in &self.differences {
            let [total, heading, inclination] = [rms.total, rms.heading, rms.inclination].map(|deg| number(deg, 3));
            write!(
                f,
                "\n{trial}: {to} differs from {from} by total {total}°, heading {heading}°, inclination {inclination}° (RMS)"
            )?;
        }
        for Sweep { fuser, setting, unit, objective, before, best, .. } in self.swept.iter().chain(&self.tuned) {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            write!(
                f,
                "\n{fuser}: best {setting} = {}{unit} with {objective} error {:.3}°; before: {}{unit} with {:.3}°",
                best.value, best.error_deg, before.value, before.error_deg
            )?;
        }
        match &self.recommendation {
            Some(recommendation) => write!(f, "\n{}", recommendation.text),
            None => Ok(()),
        }
    }
}

/// Returns the table of total, heading and inclination errors and the time per update.
fn errors(scores: &Scores) -> String {
    let head = ["RMSE, degrees", "fuser", "total", "heading", "inclination", "ns/update"];
    let line = |name: &str, fuser: &str, errors: &Errors, is_known: bool, ns: Option<f64>| {
        let attitude = errors.attitude;
        let (total, heading) = match attitude.inclination {
            Some(_) if !is_known => (number(None, 3), "arb.".into()),
            _ => (number(attitude.total, 3), number(attitude.heading, 3)),
        };
        vec![name.into(), fuser.into(), total, heading, number(attitude.inclination, 3), number(ns, 0)]
    };
    let trial_lines = |name: &str, stage: &StageScore, trial: &TrialScore| {
        let trial_line = line(name, &stage.fuser, &trial.error, trial.heading_is_known, trial.ns_per_update);
        let spread = trial.spread.iter().flat_map(spread_lines);
        let spread = spread.map(|(label, errors)| line(&label, "", &errors, trial.heading_is_known, None));
        [trial_line].into_iter().chain(spread).collect()
    };
    let mean = |name: &str, stage: &StageScore| {
        line(name, &stage.fuser, &stage.mean, stage.heading_is_known(), stage.ns_per_update)
    };
    aligned(&head, &rows(scores, trial_lines, mean))
}

/// Returns the table of angle, course and gyro bias errors, and of the heading drift.
fn all_errors(scores: &Scores) -> String {
    let head = [
        "RMSE and drift",
        "fuser",
        "roll, °",
        "pitch, °",
        "yaw, °",
        "course, °",
        "bias, °/s",
        "drift, °/min",
        "at end, °",
    ];
    let line = |name: &str, fuser: &str, values: [String; ERROR_COUNT]| {
        let [_, _, _, angle_cells @ ..] = values;
        [name.into(), fuser.into()].into_iter().chain(angle_cells).collect::<Vec<String>>()
    };
    let numbers = |errors: &Errors| {
        let mut names = Errors::NAMES.into_iter();
        errors.values().map(|value| number(value, if names.next() == Some("gyro_bias_deg_s") { 4 } else { 3 }))
    };
    let trial_lines = |name: &str, stage: &StageScore, trial: &TrialScore| {
        let mut lines = vec![line(name, &stage.fuser, numbers(&trial.error))];
        if let Some(spread) = &trial.spread {
            lines.extend(spread_lines(spread).into_iter().map(|(label, errors)| line(&label, "", numbers(&errors))));
            let seed = |name| spread.worst_seed_by_error.get(name).map_or_else(|| number(None, 0), u64::to_string);
            lines.push(line("  worst seed of each", "", Errors::NAMES.map(seed)));
        }
        lines
    };
    aligned(&head, &rows(scores, trial_lines, |name, stage| line(name, &stage.fuser, numbers(&stage.mean))))
}

/// Returns the table of normalised errors, each as a ratio to its ideal value.
fn normalised(scores: &Scores) -> String {
    let head = [
        "error / reported SD / ideal",
        "fuser",
        "incl. 68 %",
        "incl. 95 %",
        "head. 68 %",
        "head. 95 %",
        "course 68 %",
        "course 95 %",
    ];
    let line = |name: &str, fuser: &str, normalised: &crate::normalised::NormalisedErrors| {
        let cells = |quantiles: &Option<RatioQuantiles>| {
            [0, 1].map(|at| number(quantiles.map(|quantiles| quantiles.over_ideal[at]), 2))
        };
        let numbers = [&normalised.inclination, &normalised.heading, &normalised.course].into_iter().flat_map(cells);
        [name.into(), fuser.into()].into_iter().chain(numbers).collect::<Vec<String>>()
    };
    let trial_lines =
        |name: &str, stage: &StageScore, trial: &TrialScore| vec![line(name, &stage.fuser, &trial.normalised)];
    let rows = rows(scores, trial_lines, |_, stage| line("all samples", &stage.fuser, &stage.normalised));
    aligned(&head, &rows)
}

/// Returns one line with the heading drift for each chain in which the zero direction of the
/// heading is arbitrary.
fn drifts(scores: &Scores) -> Vec<String> {
    let drift_line = |stage: &StageScore| {
        let (deg_min, end_deg) = stage.mean.drift_deg_min.zip(stage.mean.drift_end_deg)?;
        let known = stage.trials.iter().filter(|trial| trial.error.drift_end_deg.is_some());
        let runs = known.map(|trial| trial.spread.as_ref().map_or(1, |spread| spread.seeds)).sum();
        let (deg_min, end_deg, on_average) = match &stage.trials[..] {
            [one] if one.spread.is_none() => (one.error.drift_deg_min?, one.error.drift_end_deg?, String::new()),
            _ => (deg_min, end_deg, format!(", mean magnitude over {}", launch::pluralize(runs, "run"))),
        };
        let sign = if on_average.is_empty() { "+" } else { "" };
        let signed = |value: f64, digits: usize| {
            if sign.is_empty() { format!("{value:.digits$}") } else { format!("{value:+.digits$}") }
        };
        Some(format!(
            "{}: heading arbitrary (arb.), drift {}°/min, {}° at the end{on_average}",
            stage.fuser,
            signed(deg_min, 3),
            signed(end_deg, 2)
        ))
    };
    scores.stages.iter().filter_map(drift_line).collect()
}

/// Formats a number, or a dash for `None`.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("—".into(), |value| format!("{value:.digits$}"))
}

/// Returns the lines of each trial for all chains, followed by the means if there are several
/// trials.
fn rows(
    scores: &Scores,
    trial_lines: impl Fn(&str, &StageScore, &TrialScore) -> Vec<Vec<String>>,
    mean: impl Fn(&str, &StageScore) -> Vec<String>,
) -> Vec<Vec<String>> {
    let Some(first) = scores.stages.first() else { return Vec::new() };
    let mut rows = Vec::new();
    for (index, trial) in first.trials.iter().enumerate() {
        let trial_name = trial.name.to_string();
        let mut name = trial_name.as_str();
        for stage in &scores.stages {
            rows.extend(stage.trials.get(index).into_iter().flat_map(|trial| trial_lines(name, stage, trial)));
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

/// Aligns text columns to the left and number columns to the right.
fn aligned(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        let min_width = if column < TEXT_COLUMNS { 0 } else { MIN_NUMBER_WIDTH };
        cells.chain([head[column].chars().count()]).max().unwrap_or(0).max(min_width)
    };
    let widths: Vec<_> = (0..head.len()).map(width).collect();
    let head = head.iter().map(ToString::to_string).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column < TEXT_COLUMNS { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        cells.collect::<Vec<_>>().join("  ")
    };
    [&head].into_iter().chain(rows).map(line).collect::<Vec<_>>().join("\n")
}

/// Returns a labelled line for each statistic of a spread.
fn spread_lines(spread: &Spread) -> Vec<(String, Errors)> {
    let quantiles = QUANTILES
        .iter()
        .zip(spread.quantiles)
        .map(|(probability, errors)| (format!("  {} % quantile", probability * 100.0), errors));
    let worst = (format!("  worst (seed {})", spread.worst_seed), spread.worst);
    [("  SD".to_owned(), spread.sd)].into_iter().chain(quantiles).chain([worst]).collect()
}
