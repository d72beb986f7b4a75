//! Calibration report: the estimates with standard deviations, or what is missing.

use std::fmt;

use attitude::{Matrix3, Vector3};
use serde::Serialize;

use crate::input::Kind;

/// Extent to which the readings so far meet the conditions of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Coverage {
    /// Fraction of the conditions that are met, 0 to 1. Includes only conditions that can be
    /// checked before the calibration is computed.
    pub share: f64,
    /// Summary of the readings, as one phrase.
    pub summary: String,
    /// Unmet conditions, each with an instruction; empty if `share` is 1.
    pub missing: Vec<String>,
}

impl Coverage {
    /// Returns the share in whole per cent, rounded down.
    pub fn percent(&self) -> f64 {
        (100.0 * self.share).floor()
    }
}

/// Estimated quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Value {
    /// Name of the quantity.
    pub name: &'static str,
    /// Components of the estimate, in `unit`.
    pub value: Vec<f64>,
    /// Standard deviations of the components.
    pub sd: Vec<f64>,
    /// Unit of `value` and `sd`; empty if dimensionless.
    pub unit: &'static str,
}

impl Value {
    pub(crate) fn vector(name: &'static str, value: Vector3<f64>, sd: Vector3<f64>, unit: &'static str) -> Self {
        Self { name, value: value.iter().copied().collect(), sd: sd.iter().copied().collect(), unit }
    }
}

/// Residuals of the readings relative to the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Residual {
    /// Description of the residual, such as `RMS of |f| − g`.
    pub quantity: &'static str,
    /// Value of `quantity` for the raw readings.
    pub before: f64,
    /// Value of `quantity` for the calibrated readings.
    pub after: f64,
    /// Unit of `before` and `after`.
    pub unit: &'static str,
}

/// Result of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Name of the sensor or quantity, as [`Kind`] displays it.
    pub kind: &'static str,
    /// Estimated quantities.
    pub values: Vec<Value>,
    /// Residuals before and after calibration.
    pub residual: Residual,
    /// Coverage achieved by the readings.
    pub coverage: Coverage,
    /// Remarks for the user.
    pub notes: Vec<String>,
    /// Name of the launch file section that `block` replaces.
    pub replaces: &'static str,
    /// Section for the launch file, TOML.
    pub block: String,
}

impl Report {
    /// Returns the estimates as text, without the section for the launch file.
    pub fn summary(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_summary(&mut text);
        text
    }

    fn write_summary(&self, f: &mut dyn fmt::Write) -> fmt::Result {
        let Self { kind, values, residual, coverage, notes, .. } = self;
        writeln!(f, "{kind}: {}; coverage {:.0} %", coverage.summary, coverage.percent())?;
        for Value { name, value, sd, unit } in values {
            let list = |numbers: &[f64]| numbers.iter().map(|x| format_value(*x, sd)).collect::<Vec<_>>().join("  ");
            let sds = sd.iter().map(|x| format!("{x:.2}", x = Rounded(*x))).collect::<Vec<_>>().join("  ");
            writeln!(f, "  {name:<18} {}  ± {sds} {unit}", list(value))?;
        }
        let Residual { quantity, before, after, unit } = residual;
        writeln!(f, "  {quantity}: {:.3} {unit} before, {:.3} {unit} after", Rounded(*before), Rounded(*after))?;
        notes.iter().try_for_each(|note| writeln!(f, "  {note}"))
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_summary(f)?;
        let Self { replaces, block, .. } = self;
        write!(f, "\nAdd to launch.toml, replacing any existing {replaces}:\n\n{block}")
    }
}

/// Formats a value. The number of decimals is chosen so that the largest standard deviation has two
/// significant digits.
fn format_value(value: f64, sd: &[f64]) -> String {
    let largest = sd.iter().copied().fold(0.0, f64::max);
    let decimals = if largest > 0.0 { (1.0 - largest.log10().floor()).clamp(0.0, 7.0) as usize } else { 6 };
    format!("{value:.decimals$}")
}

/// Number to be displayed with a given number of significant digits: the formatter's precision, or
/// 3 by default.
struct Rounded(f64);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(3) as f64;
        // An exactly determined fit has only rounding errors as residuals. They are shown as 0.
        if self.0.abs() < 1e-9 {
            return f.write_str("0");
        }
        if !self.0.is_finite() {
            return write!(f, "{}", self.0);
        }
        let decimals = (digits - 1.0 - self.0.abs().log10().floor()).clamp(0.0, 12.0) as usize;
        write!(f, "{:.decimals$}", self.0)
    }
}

/// Rejection of readings that yield no calibration, with the reason.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[error("{kind} calibration failed: {} ({})\n{}", match coverage.share < 1.0 {
    true => format!("the readings cover {:.0} % of what is needed", coverage.percent()),
    false => "the readings are not sufficient".into(),
}, coverage.summary, missing.iter().map(|need| format!("  missing: {need}")).collect::<Vec<_>>().join("\n"))]
pub struct Rejection {
    /// Name of the sensor or quantity, as [`Kind`] displays it.
    pub kind: String,
    /// Coverage achieved by the readings.
    pub coverage: Coverage,
    /// Unmet conditions, each with an instruction.
    pub missing: Vec<String>,
}

impl Rejection {
    /// Creates a rejection for incomplete coverage.
    pub(crate) fn incomplete(kind: Kind, coverage: Coverage) -> Self {
        Self { kind: kind.to_string(), missing: coverage.missing.clone(), coverage }
    }

    /// Creates a rejection for a result that is unusable despite complete coverage.
    pub(crate) fn unreliable(kind: Kind, coverage: Coverage, missing: String) -> Self {
        Self { kind: kind.to_string(), missing: vec![missing], coverage }
    }
}

/// Formats a TOML array.
pub(crate) fn array(values: &[f64]) -> String {
    // `+ 0.0` turns −0 into 0. No sensor resolves more than seven decimals.
    format!("[{}]", values.iter().map(|x| format!("{:.7}", x + 0.0)).collect::<Vec<_>>().join(", "))
}

/// Formats a number with a noun, in the plural unless the number is 1.
pub(crate) fn pluralize(number: usize, noun: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

/// Formats the rows of a matrix as a TOML array of arrays.
pub(crate) fn rows(matrix: &Matrix3<f64>) -> String {
    let rows = matrix.row_iter().map(|row| array(&row.iter().copied().collect::<Vec<_>>()));
    format!("[{}]", rows.collect::<Vec<_>>().join(", "))
}
