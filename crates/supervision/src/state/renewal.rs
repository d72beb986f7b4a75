//! State of bus renewals. A renewal replaces a bus after its files were removed.

use std::{collections::VecDeque, time::Duration};

/// Recent renewals of the bus, and the state of the current one.
#[derive(Debug, Default)]
pub(crate) struct Renewals {
    pub(crate) renewals: VecDeque<Duration>,
    /// Set once the fault of the bus files has been announced to the user.
    pub(crate) announced: bool,
    pub(crate) under_way: bool,
    /// Set if a process other than an owner has just exited before it could join the bus.
    pub(crate) join_failed: bool,
}

impl Renewals {
    pub(crate) fn is_under_way(&self) -> bool {
        self.under_way
    }

    /// Records whether a process other than an owner has just exited before it could join the bus.
    /// The record is cleared at each timer event.
    pub(crate) fn set_join_failed(&mut self, join_failed: bool) {
        self.join_failed = join_failed;
    }

    /// Returns the number of renewals within the last `window`.
    pub(crate) fn count_recent(&mut self, now: Duration, window: Duration) -> usize {
        while self.renewals.pop_front_if(|at| *at + window < now).is_some() {}
        self.renewals.len()
    }
}
