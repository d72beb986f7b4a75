//! Whether the machine and the system are as they should be: what was found, and the remedy.
//!
//! | module | what it looks at |
//! | --- | --- |
//! | [`machine`] | shared memory, limits, clock, processor |
//! | [`leftovers`] | what dead systems and killed processes have left behind |
//! | [`running`] | services, rates and flags of a running system |
//! | [`still`] | what the sensors say while nothing moves |

pub mod leftovers;
pub mod machine;
pub mod running;
pub mod still;

use std::fmt;

use launch::pluralize;
use serde::Serialize;

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// As it should be.
    Ok,
    /// It works, but not as well as it could.
    Warning,
    /// Something will not work.
    Problem,
}

/// One check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// What was looked at.
    pub check: &'static str,
    /// How it ended.
    pub result: Outcome,
    /// What was found.
    pub found: String,
    /// What to do about it.
    pub remedy: Option<String>,
}

/// All checks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// The system looked at.
    pub system: String,
    /// The checks.
    pub checks: Vec<Check>,
}

impl Check {
    /// As it should be.
    pub fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self { check, result: Outcome::Ok, found: found.into(), remedy: None }
    }

    /// It works, but not as well as it could.
    pub fn warning(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { check, result: Outcome::Warning, found: found.into(), remedy: Some(remedy.into()) }
    }

    /// Something will not work.
    pub fn problem(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { check, result: Outcome::Problem, found: found.into(), remedy: Some(remedy.into()) }
    }
}

impl Diagnosis {
    /// How many checks ended so.
    pub fn count(&self, result: Outcome) -> usize {
        self.checks.iter().filter(|check| check.result == result).count()
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.result {
            Outcome::Ok => "ok",
            Outcome::Warning => "warning",
            Outcome::Problem => "PROBLEM",
        };
        write!(f, "{word:<9}{:<16}{}", self.check, self.found)?;
        self.remedy.iter().try_for_each(|remedy| write!(f, "\n{:<25}→ {remedy}", ""))
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.checks.iter().try_for_each(|check| writeln!(f, "{check}"))?;
        let all = [(Outcome::Problem, "problem"), (Outcome::Warning, "warning")];
        let [problems, warnings] = all.map(|(outcome, noun)| pluralize(self.count(outcome) as u64, noun));
        write!(f, "{problems}, {warnings}")
    }
}
