//! Reassembly of the tick stream from frames that may be lost, repeated or reordered.
//!
//! Input: frames in any order.
//!
//! Output: each tick once and in order, and the spans of ticks that can no longer arrive.
//!
//! Failure: a frame that is from another run, has another tick rate or lacks a required topic is
//! rejected.

use std::collections::BTreeMap;
use std::ops::Range;

use super::{
    frame::{Frame, FrameHeader},
    record::{Record, topics_in},
};

/// Maximum number of ticks by which a stored tick may be ahead of the next tick to deliver.
pub const MAX_AHEAD_TICKS: u64 = 65_536;

/// Next element of the stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Delivery {
    /// Record of one tick.
    Record(Record),
    /// Ticks that the exporter no longer caches.
    Lost(Range<u64>),
}

/// Tick stream being reassembled, with the records received ahead of the next tick.
#[derive(Debug)]
pub struct Reassembly {
    mask: u8,
    rate_hz: f64,
    run: Option<u64>,
    next_tick: u64,
    end_tick: u64,
    /// Ticks cached by the exporter, according to the frames received.
    cached: Range<u64>,
    ahead: BTreeMap<u64, Record>,
}

/// Reason for rejecting a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReassemblyError {
    /// The exporting system has restarted.
    #[error(
        "cannot import ticks: the system on the other host has restarted and counts ticks from 0; restart this system"
    )]
    Run,
    /// The tick rates differ.
    #[error(
        "cannot import ticks: rate is {remote} Hz on the other host, {local} Hz on this one; set the same rate in both launch files"
    )]
    Rate {
        /// Rate of this system, Hz.
        local: f64,
        /// Rate of the exporter, Hz.
        remote: f64,
    },
    /// A required topic is not exported.
    #[error("cannot import ticks: the other host does not export {topic:?}; add it to `export` in its [gateway]")]
    Topic {
        /// Name of the topic.
        topic: &'static str,
    },
}

impl Reassembly {
    /// Creates the reassembly of the topics in `mask` for the ticks `next_tick..end_tick`.
    ///
    /// `run` is the run of the exporter, if known from an earlier incarnation.
    pub fn new(mask: u8, rate_hz: f64, run: Option<u64>, next_tick: u64, end_tick: u64) -> Self {
        Self { mask, rate_hz, run, next_tick, end_tick, cached: 0..0, ahead: BTreeMap::new() }
    }

    /// Stores the records of a frame that are new and within [`MAX_AHEAD_TICKS`] of the next tick.
    ///
    /// # Errors
    ///
    /// Returns an error if the frame is from another run, has another tick rate, or lacks a topic.
    pub fn offer(&mut self, frame: Frame) -> Result<(), ReassemblyError> {
        let Frame { header, records } = frame;
        self.check(&header)?;
        self.run = Some(header.run);
        self.cached = self.cached.start.max(header.oldest_tick)..self.cached.end.max(header.next_tick);
        let window = self.next_tick..self.next_tick.saturating_add(MAX_AHEAD_TICKS);
        for record in records.into_iter().filter(|record| window.contains(&record.tick)) {
            self.ahead.entry(record.tick).or_insert(record);
        }
        Ok(())
    }

    /// Returns the next record or lost span, or `None` while the next tick can still arrive.
    pub fn next_delivery(&mut self) -> Option<Delivery> {
        if self.is_complete() {
            return None;
        }
        if let Some(record) = self.ahead.remove(&self.next_tick) {
            self.next_tick += 1;
            return Some(Delivery::Record(record));
        }
        let lost = self.lost();
        if lost.is_empty() {
            return None;
        }
        self.next_tick = lost.end;
        Some(Delivery::Lost(lost))
    }

    /// Returns `true` if a record or lost span is available.
    pub fn is_ready(&self) -> bool {
        !self.is_complete() && (self.ahead.contains_key(&self.next_tick) || !self.lost().is_empty())
    }

    /// Returns the range of ticks, starting at the next one, that can no longer arrive.
    fn lost(&self) -> Range<u64> {
        let first_ahead = self.ahead.first_key_value().map_or(u64::MAX, |(tick, _)| *tick);
        self.next_tick..self.cached.start.min(first_ahead).min(self.end_tick)
    }

    /// Returns the span to request, which starts at the next tick. It ends before the first stored
    /// record or, if no record is stored, at the end of the exporter's cache.
    pub fn missing(&self) -> Option<Range<u64>> {
        let first_ahead = self.ahead.first_key_value().map_or(self.cached.end, |(tick, _)| *tick);
        let missing = self.next_tick..first_ahead.min(self.end_tick);
        (!missing.is_empty()).then_some(missing)
    }

    /// Returns the next tick to deliver.
    pub fn next_tick(&self) -> u64 {
        self.next_tick
    }

    /// Returns the run of the exporter, if known.
    pub fn run(&self) -> Option<u64> {
        self.run
    }

    /// Returns `true` if all ticks have been delivered.
    pub fn is_complete(&self) -> bool {
        self.next_tick >= self.end_tick
    }

    fn check(&self, header: &FrameHeader) -> Result<(), ReassemblyError> {
        if self.run.is_some_and(|run| run != header.run) {
            return Err(ReassemblyError::Run);
        }
        if self.rate_hz != header.rate_hz {
            return Err(ReassemblyError::Rate { local: self.rate_hz, remote: header.rate_hz });
        }
        match topics_in(self.mask & !header.mask()).next() {
            Some((_, topic)) => Err(ReassemblyError::Topic { topic: topic.name }),
            None => Ok(()),
        }
    }
}
