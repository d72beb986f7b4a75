//! What is printed: what was found with its standard deviations, or what is missing.

use std::fmt;

use attitude::{Matrix3, Vector3};
use serde::Serialize;

use crate::Kind;

/// How far the readings suffice.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Coverage {
    /// 0 to 1; at 1 there is enough of everything that can be counted beforehand.
    pub share: f64,
    /// What there is, for people.
    pub found: String,
    /// What is still to be done, for people; empty at a share of 1.
    pub missing: Vec<String>,
}

impl Coverage {
    /// The share in whole per cent, never more than it is.
    pub fn percent(&self) -> f64 {
        (100.0 * self.share).floor()
    }
}

/// One quantity that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Value {
    /// What it is.
    pub name: &'static str,
    /// Its parts.
    pub value: Vec<f64>,
    /// Their standard deviations.
    pub sd: Vec<f64>,
    /// Of both.
    pub unit: &'static str,
}

impl Value {
    pub(crate) fn vector(name: &'static str, value: Vector3<f64>, sd: Vector3<f64>, unit: &'static str) -> Self {
        Self { name, value: value.iter().copied().collect(), sd: sd.iter().copied().collect(), unit }
    }
}

/// What is left of the readings' disagreement with the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Residual {
    /// What it is, for people.
    pub of: &'static str,
    /// Root of the mean square of the raw readings.
    pub before: f64,
    /// The same with what was found.
    pub after: f64,
    /// Of both.
    pub unit: &'static str,
}

/// A calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// What was calibrated.
    pub kind: &'static str,
    /// What was found.
    pub values: Vec<Value>,
    /// Before and after.
    pub residual: Residual,
    /// Of the readings.
    pub coverage: Coverage,
    /// What else is to be known about it.
    pub notes: Vec<String>,
    /// What it takes the place of in a launch file.
    pub replaces: &'static str,
    /// The piece of a launch file.
    pub block: String,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, values, residual, coverage, notes, replaces, block } = self;
        writeln!(f, "{kind}: {}; coverage {:.0} %", coverage.found, coverage.percent())?;
        for Value { name, value, sd, unit } in values {
            let list = |numbers: &[f64]| numbers.iter().map(|x| significant(*x, sd)).collect::<Vec<_>>().join("  ");
            let sds = sd.iter().map(|x| format!("{x:.2}", x = Rounded(*x))).collect::<Vec<_>>().join("  ");
            writeln!(f, "  {name:<18} {}  ± {sds} {unit}", list(value))?;
        }
        let Residual { of, before, after, unit } = residual;
        writeln!(f, "  {of}: {:.3} {unit} before, {:.3} {unit} after", Rounded(*before), Rounded(*after))?;
        notes.iter().try_for_each(|note| writeln!(f, "  {note}"))?;
        write!(f, "\nIn launch.toml, in place of {replaces}:\n\n{block}")
    }
}

/// As many decimals as the largest standard deviation leaves, and one more.
fn significant(value: f64, sd: &[f64]) -> String {
    let largest = sd.iter().copied().fold(0.0, f64::max);
    let decimals = if largest > 0.0 { (1.0 - largest.log10().floor()).clamp(0.0, 7.0) as usize } else { 6 };
    format!("{value:.decimals$}")
}

/// A number by so many significant digits.
struct Rounded(f64);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(3) as f64;
        if self.0 == 0.0 || !self.0.is_finite() {
            return write!(f, "{}", self.0);
        }
        let decimals = (digits - 1.0 - self.0.abs().log10().floor()).clamp(0.0, 12.0) as usize;
        write!(f, "{:.decimals$}", self.0)
    }
}

/// Why there is no calibration.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[error("calibrating the {kind}: {} ({})\n{}", match coverage.share < 1.0 {
    true => format!("the readings cover {:.0} % of what is needed", coverage.percent()),
    false => "the readings do not suffice".into(),
}, coverage.found, missing.iter().map(|what| format!("  missing: {what}")).collect::<Vec<_>>().join("\n"))]
pub struct Refusal {
    /// What was to be calibrated.
    pub kind: String,
    /// Of the readings.
    pub coverage: Coverage,
    /// What is to be done, for people.
    pub missing: Vec<String>,
}

impl Refusal {
    /// Thin coverage.
    pub(crate) fn thin(kind: Kind, coverage: Coverage) -> Self {
        Self { kind: kind.to_string(), missing: coverage.missing.clone(), coverage }
    }

    /// Coverage of which too little follows.
    pub(crate) fn weak(kind: Kind, coverage: Coverage, missing: String) -> Self {
        Self { kind: kind.to_string(), missing: vec![missing], coverage }
    }
}

/// An array of TOML.
pub(crate) fn array(values: &[f64]) -> String {
    // 0 for −0, and no more digits than any sensor has.
    format!("[{}]", values.iter().map(|x| format!("{:.7}", x + 0.0)).collect::<Vec<_>>().join(", "))
}

/// Rows of TOML.
pub(crate) fn rows(matrix: &Matrix3<f64>) -> String {
    let rows = matrix.row_iter().map(|row| array(&row.iter().copied().collect::<Vec<_>>()));
    format!("[{}]", rows.collect::<Vec<_>>().join(", "))
}
