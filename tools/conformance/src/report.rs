//! What the kit found: one line for each check.

use std::fmt;

use launch::pluralize;
use serde::Serialize;

/// How a stage did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// The slot that the stage fills.
    pub slot: &'static str,
    /// The stage's name.
    pub stage: String,
    /// In the order in which they were made.
    pub checks: Vec<Check>,
}

/// One property that a stage has or has not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// The property, as a sentence.
    pub name: String,
    /// The stage has it.
    pub passed: bool,
    /// What was measured, where the property is a number.
    pub figure: Option<Figure>,
    /// Where it failed first, and how.
    pub failed_at: Option<String>,
}

/// A measured number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figure {
    /// The number; `None` where the event never came.
    pub value: Option<f64>,
    /// The most that is allowed; `None` where nothing is demanded.
    pub limit: Option<f64>,
    /// Its unit.
    pub unit: &'static str,
}

impl Report {
    /// The stage has every property.
    pub fn passed(&self) -> bool {
        self.checks.iter().all(|check| check.passed)
    }

    /// The checks that failed.
    pub fn failures(&self) -> impl Iterator<Item = &Check> {
        self.checks.iter().filter(|check| !check.passed)
    }
}

impl Check {
    /// A property that holds, or fails at the place told.
    pub fn holds(name: impl Into<String>, failed_at: Option<String>) -> Self {
        Self { name: name.into(), passed: failed_at.is_none(), figure: None, failed_at }
    }

    /// A number that may not be above its limit.
    pub fn most(name: impl Into<String>, figure: Figure, at: impl FnOnce() -> String) -> Self {
        let passed = figure.limit.is_none_or(|limit| figure.value.is_some_and(|value| value <= limit));
        Self { name: name.into(), passed, figure: Some(figure), failed_at: (!passed).then(at) }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let failed = self.failures().count();
        write!(f, "{} {}: {}", self.slot, self.stage, pluralize(self.checks.len() as u64, "check"))?;
        if failed > 0 {
            write!(f, ", {failed} failed")?;
        }
        self.checks.iter().try_for_each(|check| write!(f, "\n{check}"))
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "  {}  {}", if self.passed { "ok    " } else { "FAILED" }, self.name)?;
        if let Some(figure) = &self.figure {
            write!(f, ": {figure}")?;
        }
        self.failed_at.as_ref().map_or(Ok(()), |at| write!(f, " ({at})"))
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.value {
            Some(value) => write!(f, "{value:.3} {}", self.unit)?,
            None => write!(f, "never")?,
        }
        match self.limit {
            Some(limit) => write!(f, ", at most {limit:.3}"),
            None => write!(f, ", no limit"),
        }
    }
}
