//! What came, what is missing, and what is lost for good.
//!
//! Input: frames in any order, again and again, or not at all. Output: every tick once, in order, and every span of ticks that can no
//! longer come. Time: none. Failure: a frame of another run, rate or without the topics wanted is refused.

use std::collections::BTreeMap;
use std::ops::Range;

use super::{
    frame::{Frame, Head},
    record::{Record, places},
};

/// Ticks beyond the next one that are kept until those before them have come.
pub const AHEAD_MAX: u64 = 65_536;

/// What has its turn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Turn {
    /// A tick.
    Record(Record),
    /// Ticks that the exporter no longer keeps.
    Lost(Range<u64>),
}

/// The stream so far.
#[derive(Debug)]
pub struct Arrivals {
    mask: u8,
    rate_hz: f64,
    run: Option<u64>,
    next_tick: u64,
    end_tick: u64,
    /// What the exporter keeps, as far as is known.
    kept: Range<u64>,
    ahead: BTreeMap<u64, Record>,
}

/// Why a frame was not taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ArrivalError {
    /// The exporter began anew.
    #[error(
        "importing: the other host's system was started anew and counts its ticks from 0; start this one anew as well"
    )]
    Run,
    /// Another rate.
    #[error("importing: {there} Hz there and {here} Hz here; write one rate into both launch files")]
    Rate {
        /// Here, Hz.
        here: f64,
        /// There, Hz.
        there: f64,
    },
    /// A topic is not exported.
    #[error("importing: the other host does not export {topic:?}; add it to its [gateway] export")]
    Topic {
        /// The topic.
        topic: &'static str,
    },
}

impl Arrivals {
    /// Waits for the topics of `mask` of all ticks from `next_tick` to before `end_tick`. Of which run, if that is known.
    pub fn new(mask: u8, rate_hz: f64, run: Option<u64>, next_tick: u64, end_tick: u64) -> Self {
        Self { mask, rate_hz, run, next_tick, end_tick, kept: 0..0, ahead: BTreeMap::new() }
    }

    /// Takes a frame, of which only what is new and near counts.
    pub fn offer(&mut self, frame: Frame) -> Result<(), ArrivalError> {
        let Frame { head, records } = frame;
        self.check(&head)?;
        self.run = Some(head.run);
        self.kept = self.kept.start.max(head.oldest_tick)..self.kept.end.max(head.next_tick);
        let near = self.next_tick..self.next_tick.saturating_add(AHEAD_MAX);
        for record in records.into_iter().filter(|record| near.contains(&record.tick)) {
            self.ahead.entry(record.tick).or_insert(record);
        }
        Ok(())
    }

    /// What has its turn, if that is known.
    pub fn take(&mut self) -> Option<Turn> {
        if self.is_whole() {
            return None;
        }
        if let Some(record) = self.ahead.remove(&self.next_tick) {
            self.next_tick += 1;
            return Some(Turn::Record(record));
        }
        let lost = self.lost();
        if lost.is_empty() {
            return None;
        }
        self.next_tick = lost.end;
        Some(Turn::Lost(lost))
    }

    /// Something has its turn.
    pub fn is_ready(&self) -> bool {
        !self.is_whole() && (self.ahead.contains_key(&self.next_tick) || !self.lost().is_empty())
    }

    /// The ticks from the next one on that can no longer come.
    fn lost(&self) -> Range<u64> {
        let first_ahead = self.ahead.first_key_value().map_or(u64::MAX, |(tick, _)| *tick);
        self.next_tick..self.kept.start.min(first_ahead).min(self.end_tick)
    }

    /// The ticks to ask for: those before what has come, or all that the exporter has beyond.
    pub fn missing(&self) -> Option<Range<u64>> {
        let first_ahead = self.ahead.first_key_value().map_or(self.kept.end, |(tick, _)| *tick);
        let missing = self.next_tick..first_ahead.min(self.end_tick);
        (!missing.is_empty()).then_some(missing)
    }

    /// The tick that comes next.
    pub fn next_tick(&self) -> u64 {
        self.next_tick
    }

    /// The run that the ticks are of.
    pub fn run(&self) -> Option<u64> {
        self.run
    }

    /// Nothing more is wanted.
    pub fn is_whole(&self) -> bool {
        self.next_tick >= self.end_tick
    }

    fn check(&self, head: &Head) -> Result<(), ArrivalError> {
        if self.run.is_some_and(|run| run != head.run) {
            return Err(ArrivalError::Run);
        }
        if self.rate_hz != head.rate_hz {
            return Err(ArrivalError::Rate { here: self.rate_hz, there: head.rate_hz });
        }
        match places(self.mask & !head.mask()).next() {
            Some((_, topic)) => Err(ArrivalError::Topic { topic: topic.name }),
            None => Ok(()),
        }
    }
}
