//! The newest records, kept for who was cut off.

use std::collections::VecDeque;

use super::record::Record;

/// Contiguous records, the newest so many.
#[derive(Debug)]
pub struct Cache {
    records: VecDeque<Record>,
    max: usize,
}

impl Cache {
    /// An empty cache for `max` records.
    pub fn new(max: usize) -> Self {
        Self { records: VecDeque::new(), max: max.max(1) }
    }

    /// Keeps the next record; the oldest goes where there are too many. One that does not follow begins anew.
    pub fn push(&mut self, record: Record) {
        if self.next_tick().is_some_and(|next_tick| next_tick != record.tick) {
            self.records.clear();
        }
        if self.records.len() == self.max {
            self.records.pop_front();
        }
        self.records.push_back(record);
    }

    /// The oldest tick that is kept.
    pub fn oldest_tick(&self) -> Option<u64> {
        self.records.front().map(|record| record.tick)
    }

    /// The tick after the newest that is kept.
    pub fn next_tick(&self) -> Option<u64> {
        self.records.back().map(|record| record.tick + 1)
    }

    /// The records from this tick on, or from the oldest if that is later.
    pub fn from(&self, tick: u64) -> impl Iterator<Item = &Record> {
        let skipped = self.oldest_tick().map_or(0, |oldest_tick| tick.saturating_sub(oldest_tick));
        let skipped = usize::try_from(skipped).unwrap_or(usize::MAX).min(self.records.len());
        self.records.range(skipped..)
    }
}
