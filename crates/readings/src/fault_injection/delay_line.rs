//! Stores the source's recent readings, from which delayed values are taken.
//!
//! Input: readings.
//!
//! Output: the readings received within the longest delay, by index.
//!
//! Time: that of the fault injector.
//!
//! Failure: if readings arrive faster than any sensor should send them, the oldest are discarded
//! early.

use std::collections::VecDeque;

use launch::{Fault, FaultKind, MAX_DELAYED_READINGS};

use crate::source::Reading;

/// Buffer that keeps each reading for the longest delay.
#[derive(Debug, Clone)]
pub(super) struct DelayLine {
    readings: VecDeque<(i64, Reading)>,
    /// Index of the oldest reading in the buffer.
    oldest_index: u64,
    /// First reading. Its values are used until the buffer has a reading that is old enough.
    pub(super) first: Option<Reading>,
    max_delay_ns: i64,
}

impl DelayLine {
    /// Creates a buffer for the longest delay of the faults.
    pub(super) fn new(faults: &[Fault]) -> Self {
        let delay_ns = |fault: &Fault| match fault.kind {
            FaultKind::Delayed { delay_s } => (delay_s * 1e9) as i64,
            _ => 0,
        };
        let max_delay_ns = faults.iter().map(delay_ns).max().unwrap_or(0);
        let capacity = if max_delay_ns > 0 { MAX_DELAYED_READINGS } else { 0 };
        Self { readings: VecDeque::with_capacity(capacity), oldest_index: 0, first: None, max_delay_ns }
    }

    pub(super) fn push(&mut self, at_ns: i64, reading: &Reading) {
        if self.max_delay_ns == 0 {
            return;
        }
        self.first.get_or_insert(*reading);
        if self.readings.len() == MAX_DELAYED_READINGS {
            self.readings.pop_front();
            self.oldest_index += 1;
        }
        self.readings.push_back((at_ns, *reading));
    }

    /// Removes the readings that are older than the longest delay.
    pub(super) fn remove_expired(&mut self, now_ns: i64) {
        while self.readings.pop_front_if(|(at_ns, _)| now_ns - *at_ns > self.max_delay_ns).is_some() {
            self.oldest_index += 1;
        }
    }

    /// Returns the buffered readings with indices of at least `from_index`, and the index of the
    /// first of them.
    pub(super) fn since(&self, from_index: u64) -> (impl Iterator<Item = &(i64, Reading)>, u64) {
        let first_index = from_index.max(self.oldest_index);
        let skipped = ((first_index - self.oldest_index) as usize).min(self.readings.len());
        (self.readings.range(skipped..), first_index)
    }
}
