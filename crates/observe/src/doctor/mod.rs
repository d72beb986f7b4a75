//! Diagnosis of the machine and the system: findings and remedies.
//!
//! | module | subject |
//! | --- | --- |
//! | [`machine`] | shared memory, limits, clocks, processor |
//! | [`leftovers`] | leftovers of dead systems and killed processes |
//! | [`remedy`] | remedies for all findings |
//! | [`running`] | services, rates and flags of a running system |
//! | [`at_rest`] | sensor readings at rest |

pub mod at_rest;
pub mod leftovers;
pub mod machine;
pub mod remedy;
pub mod running;

use std::fmt;

use launch::pluralize;
use serde::Serialize;

use remedy::Remedy;

/// Severity of a check's result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// No fault found.
    Ok,
    /// The system works, but worse than it could.
    Warning,
    /// Something does not work.
    Problem,
}

/// Result of one check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Name of the check.
    pub check: &'static str,
    /// Severity of the result.
    pub result: Severity,
    /// Description of the finding.
    pub found: String,
    /// Remedy; `None` if the result is [`Severity::Ok`].
    pub remedy: Option<Remedy>,
}

/// All checks of the machine and a system.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DoctorReport {
    /// Name of the system.
    pub system: String,
    /// Results in the order of the checks.
    pub checks: Vec<Check>,
}

impl Check {
    /// Creates a check that found no fault.
    pub fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self { check, result: Severity::Ok, found: found.into(), remedy: None }
    }

    /// Creates a check that found a reason for a warning.
    pub fn warning(check: &'static str, found: impl Into<String>, remedy: Remedy) -> Self {
        Self { check, result: Severity::Warning, found: found.into(), remedy: Some(remedy) }
    }

    /// Creates a check that found a problem.
    pub fn problem(check: &'static str, found: impl Into<String>, remedy: Remedy) -> Self {
        Self { check, result: Severity::Problem, found: found.into(), remedy: Some(remedy) }
    }
}

impl DoctorReport {
    /// Returns the number of checks with this result.
    pub fn count(&self, result: Severity) -> usize {
        self.checks.iter().filter(|check| check.result == result).count()
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let label = match self.result {
            Severity::Ok => "ok",
            Severity::Warning => "warning",
            Severity::Problem => "PROBLEM",
        };
        write!(f, "{label:<9}{:<16}{}", self.check, self.found)?;
        self.remedy.iter().try_for_each(|remedy| write!(f, "\n{:<25}→ {remedy}", ""))
    }
}

impl fmt::Display for DoctorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.checks.iter().try_for_each(|check| writeln!(f, "{check}"))?;
        let all = [(Severity::Problem, "problem"), (Severity::Warning, "warning")];
        let [problems, warnings] = all.map(|(severity, noun)| pluralize(self.count(severity) as u64, noun));
        write!(f, "{problems}, {warnings}")
    }
}
