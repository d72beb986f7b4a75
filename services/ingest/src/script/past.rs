//! What the source gave of late, for values that are to come late.
//!
//! Input: readings. Output: those of the last seconds, by number. Time: the script's. Failure: where readings come faster than any sensor
//! gives them, the oldest are lost before their time.

use std::collections::VecDeque;

use launch::{MAX_DELAYED_READINGS, Fault, FaultKind};

use crate::source::Reading;

/// As much as the longest delay wants.
#[derive(Debug, Clone)]
pub(super) struct Past {
    readings: VecDeque<(i64, Reading)>,
    /// The number of the oldest.
    oldest: u64,
    /// What is said before there is anything so old.
    pub(super) first: Option<Reading>,
    delay_ns: i64,
}

impl Past {
    /// As long as the longest delay.
    pub(super) fn new(faults: &[Fault]) -> Self {
        let delay_ns = |fault: &Fault| match fault.kind {
            FaultKind::Delayed { delay_s } => (delay_s * 1e9) as i64,
            _ => 0,
        };
        let delay_ns = faults.iter().map(delay_ns).max().unwrap_or(0);
        let most = if delay_ns > 0 { MAX_DELAYED_READINGS } else { 0 };
        Self { readings: VecDeque::with_capacity(most), oldest: 0, first: None, delay_ns }
    }

    pub(super) fn push(&mut self, at_ns: i64, reading: &Reading) {
        if self.delay_ns == 0 {
            return;
        }
        self.first.get_or_insert(*reading);
        if self.readings.len() == MAX_DELAYED_READINGS {
            self.readings.pop_front();
            self.oldest += 1;
        }
        self.readings.push_back((at_ns, *reading));
    }

    /// What every entry has read by now.
    pub(super) fn forget(&mut self, now_ns: i64) {
        while self.readings.pop_front_if(|(at_ns, _)| now_ns - *at_ns > self.delay_ns).is_some() {
            self.oldest += 1;
        }
    }

    /// The readings from a number on, and the number of the first of them that is still there.
    pub(super) fn since(&self, next: u64) -> (impl Iterator<Item = &(i64, Reading)>, u64) {
        let next = next.max(self.oldest);
        (self.readings.range(((next - self.oldest) as usize).min(self.readings.len())..), next)
    }
}
