//! Time for the checks of a stage. Checks for which the time is too short are left out and counted.
//!
//! Each group of checks gets an equal share of the remaining time, so that every group runs some
//! checks even if the stage is slow. The first check of a group runs even if the share of the group
//! is used up, unless the time for all checks is used up. A check that runs always includes its
//! first case.

use std::{
    cell::Cell,
    time::{Duration, Instant},
};

use crate::report::Check;

/// Time for the checks of a stage.
pub(crate) struct Budget<'a> {
    /// Deadline of all checks; `None` without a limit.
    end: Option<Instant>,
    /// Deadline of the current group.
    group_end: Cell<Option<Instant>>,
    /// Number of checks of the current group that have started.
    started: Cell<u64>,
    /// Number of checks and cases of the current group that were left out.
    left_out: Cell<u64>,
    /// Function that is called with the name of each check before the check runs.
    on_check: &'a dyn Fn(&str),
}

impl<'a> Budget<'a> {
    pub(crate) fn new(time: Option<Duration>, on_check: &'a dyn Fn(&str)) -> Self {
        let end = time.map(|time| Instant::now() + time);
        Self { end, group_end: Cell::new(end), started: Cell::new(0), left_out: Cell::new(0), on_check }
    }

    /// Starts a group of checks. `groups_left` includes this group.
    pub(crate) fn start_group(&self, groups_left: u32) {
        let now = Instant::now();
        self.group_end.set(self.end.map(|end| now + end.saturating_duration_since(now) / groups_left.max(1)));
        self.started.set(0);
        self.left_out.set(0);
    }

    /// Returns the number of checks and cases of the current group that were left out.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out.get()
    }

    /// Returns `true` if there is time for a check. Otherwise, counts the check as left out.
    pub(crate) fn starts(&self, name: &str) -> bool {
        let is_first = self.started.get() == 0;
        let starts = !is_over(self.end) && (is_first || !is_over(self.group_end.get()));
        if starts {
            (self.on_check)(name);
            self.started.set(self.started.get() + 1);
        } else {
            self.left_out.set(self.left_out.get() + 1);
        }
        starts
    }

    /// Checks a property and adds the result to `checks`, if there is time for the check.
    pub(crate) fn check_property(
        &self,
        checks: &mut Vec<Check>,
        name: impl Into<String>,
        run: impl FnOnce() -> Option<String>,
    ) {
        let name = name.into();
        if self.starts(&name) {
            checks.push(Check::property(name, run()));
        }
    }

    /// Returns as many cases of a check as there is time for, but at least the first case.
    pub(crate) fn cases<I: IntoIterator>(&self, cases: I) -> impl Iterator<Item = I::Item> {
        cases.into_iter().enumerate().filter_map(|(index, case)| {
            if index == 0 || !is_over(self.group_end.get()) {
                return Some(case);
            }
            self.left_out.set(self.left_out.get() + 1);
            None
        })
    }
}

fn is_over(end: Option<Instant>) -> bool {
    end.is_some_and(|end| Instant::now() >= end)
}
