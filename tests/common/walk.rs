//! Measures the duration of each step of a walk-through, such as the first commands of a new user.

use std::{
    io::{self, Write as _},
    time::Instant,
};

/// Prints the duration of each step of a walk, and the total duration when dropped.
///
/// The output goes to standard error and bypasses the output capture of the test harness.
pub(crate) struct Walk {
    name: String,
    started: Instant,
    step_started: Instant,
    steps: u32,
}

impl Walk {
    pub(crate) fn start(name: impl Into<String>) -> Self {
        let now = Instant::now();
        Self { name: name.into(), started: now, step_started: now, steps: 0 }
    }

    /// Ends the current step and prints its name `what` and its duration.
    pub(crate) fn step(&mut self, what: &str) {
        self.print(&format!("{what}, {:.1} s", self.step_started.elapsed().as_secs_f64()));
        self.step_started = Instant::now();
        self.steps += 1;
    }

    fn print(&self, line: &str) {
        // A closed standard error does not make a test fail.
        let _ = writeln!(io::stderr(), "walk {}: {line}", self.name);
    }
}

impl Drop for Walk {
    fn drop(&mut self) {
        if self.steps > 0 {
            self.print(&format!("{} steps in {:.2} min", self.steps, self.started.elapsed().as_secs_f64() / 60.0));
        }
    }
}
