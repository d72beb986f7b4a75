//! Report of the conformance checks, with one line per check.

use std::fmt;

use launch::{Slot, pluralize};
use serde::Serialize;

/// Results of all checks of a stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Slot of the stage.
    pub slot: Slot,
    /// Name of the stage.
    pub stage: String,
    /// Checks in the order in which they ran.
    pub checks: Vec<Check>,
    /// Groups of checks that were not completed for lack of time.
    pub left_out: Vec<LeftOut>,
}

/// Checks of a group that were left out for lack of time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Name of the group.
    pub group: String,
    /// Number of checks, and of cases of checks, that were left out.
    pub count: u64,
    /// `true` if no check of the group has run.
    pub is_whole: bool,
}

/// Result of one check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Property that the check verifies, as a sentence.
    pub name: String,
    /// `true` if the stage has the property.
    pub passed: bool,
    /// Measured value, if the property is a number.
    pub measurement: Option<Measurement>,
    /// First violation of the property; `None` if the check passed.
    pub failure: Option<String>,
}

/// Measured value and its limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measurement {
    /// Measured number; `None` if the measured event did not occur.
    pub value: Option<f64>,
    /// Largest allowed value; `None` for a measurement without a limit.
    pub limit: Option<f64>,
    /// Unit of the number and its limit.
    pub unit: &'static str,
}

impl Report {
    /// Returns `true` if every check passed.
    pub fn passed(&self) -> bool {
        self.checks.iter().all(|check| check.passed)
    }

    /// Returns the checks that failed.
    pub fn failures(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|check| !check.passed)
    }
}

impl Check {
    /// Creates a check that fails with the given violation, or passes if `failure` is `None`.
    pub fn property(name: impl Into<String>, failure: Option<String>) -> Self {
        Self { name: name.into(), passed: failure.is_none(), measurement: None, failure }
    }

    /// Creates a check that passes if the measurement does not exceed its limit. `failure`
    /// describes the violation.
    pub fn at_most(name: impl Into<String>, measurement: Measurement, failure: impl FnOnce() -> String) -> Self {
        let passed = measurement.limit.is_none_or(|limit| measurement.value.is_some_and(|value| value <= limit));
        Self { name: name.into(), passed, measurement: Some(measurement), failure: (!passed).then(failure) }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let failed = self.failures().count();
        write!(f, "{} {}: {}", self.slot, self.stage, pluralize(self.checks.len() as u64, "check"))?;
        if failed > 0 {
            write!(f, ", {failed} failed")?;
        }
        self.checks.iter().try_for_each(|check| write!(f, "\n{check}"))?;
        for LeftOut { group, count, is_whole } in &self.left_out {
            match is_whole {
                true => write!(f, "\n  left out: all of {group}")?,
                false => write!(f, "\n  left out: {} of {group}", pluralize(*count, "case"))?,
            }
        }
        Ok(())
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "  {}  {}", if self.passed { "ok    " } else { "FAILED" }, self.name)?;
        if let Some(measurement) = &self.measurement {
            write!(f, ": {measurement}")?;
        }
        self.failure.as_ref().map_or(Ok(()), |failure| write!(f, " ({failure})"))
    }
}

impl fmt::Display for Measurement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.value {
            Some(value) => write!(f, "{value:.3} {}", self.unit)?,
            None => write!(f, "not reached")?,
        }
        match self.limit {
            Some(limit) => write!(f, ", at most {limit:.3}"),
            None => write!(f, ", no limit"),
        }
    }
}
