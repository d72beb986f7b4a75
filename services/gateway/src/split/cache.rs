//! Cache of the newest records, for importers that were disconnected.

use std::collections::VecDeque;

use super::record::Record;

/// Bounded sequence of contiguous records.
#[derive(Debug)]
pub struct Cache {
    records: VecDeque<Record>,
    capacity: usize,
}

impl Cache {
    /// Creates an empty cache for `capacity` records, at least one.
    pub fn new(capacity: usize) -> Self {
        Self { records: VecDeque::new(), capacity: capacity.max(1) }
    }

    /// Appends a record. A full cache drops the oldest record. A gap before the new record clears
    /// the cache.
    pub fn push(&mut self, record: Record) {
        if self.next_tick().is_some_and(|next_tick| next_tick != record.tick) {
            self.records.clear();
        }
        if self.records.len() == self.capacity {
            self.records.pop_front();
        }
        self.records.push_back(record);
    }

    /// Returns the oldest cached tick.
    pub fn oldest_tick(&self) -> Option<u64> {
        self.records.front().map(|record| record.tick)
    }

    /// Returns the tick after the newest cached one.
    pub fn next_tick(&self) -> Option<u64> {
        self.records.back().map(|record| record.tick + 1)
    }

    /// Returns the cached records starting at `tick`, or at the oldest record if that is later.
    pub fn iter_from(&self, tick: u64) -> impl Iterator<Item = &Record> {
        let skipped = self.oldest_tick().map_or(0, |oldest_tick| tick.saturating_sub(oldest_tick));
        let skipped = usize::try_from(skipped).unwrap_or(usize::MAX).min(self.records.len());
        self.records.range(skipped..)
    }
}
