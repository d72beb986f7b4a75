//! Merges all publishers of a topic into one stream, with each tick once and in order.
//!
//! - Input: messages, in order for each publisher and in any order across publishers.
//! - Output: messages in tick order, each with the number of ticks missing before it.
//! - Time: no clock is read. Waiting is measured in ticks.
//! - Failure: a missing tick is skipped and counted.

use std::collections::BTreeMap;

use crate::{Sequence, Stamped};

/// Reorder buffer of a subscriber.
#[derive(Debug, Clone)]
pub struct ReorderBuffer<M> {
    lateness_ticks: u64,
    /// End of the backlog. Earlier ticks have been published, but may not have been delivered yet.
    backlog_end: u64,
    /// Lead of a held message over `backlog_end`, in ticks, at which the backlog is given up.
    patience_ticks: u64,
    sequence: Sequence,
    /// Epoch of the last delivered message, or the initial epoch before the first delivery.
    epoch: u32,
    /// `true` until the first delivery if the stream may start at any tick.
    start_unknown: bool,
    held: BTreeMap<u64, M>,
}

impl<M: Stamped> ReorderBuffer<M> {
    /// Creates a buffer with a known first tick.
    ///
    /// `next_tick` is 0 for a subscriber that exists before the stream starts, or else the next
    /// tick of its checkpoint. `epoch` is the current epoch, or the epoch of the last message
    /// before the checkpoint.
    ///
    /// If another publisher may still send an earlier tick, a message is held until that tick
    /// arrives or until the newest held tick is `lateness_ticks` ahead of the stream. This also
    /// applies before the first delivery, because the publisher is not known then.
    pub fn new(next_tick: u64, epoch: u32, lateness_ticks: u64) -> Self {
        let sequence = Sequence { next_tick, ..Sequence::default() };
        Self {
            lateness_ticks,
            backlog_end: 0,
            patience_ticks: lateness_ticks,
            sequence,
            epoch,
            start_unknown: false,
            held: BTreeMap::new(),
        }
    }

    /// Creates a buffer for a subscriber that joins a running stream at its current epoch, `epoch`.
    ///
    /// The first message of that epoch is delivered immediately, and the ticks before it count as
    /// lost.
    pub fn with_unknown_start(epoch: u32, lateness_ticks: u64) -> Self {
        Self { start_unknown: true, ..Self::new(0, epoch, lateness_ticks) }
    }

    /// Declares that all ticks before `tick` have been published.
    ///
    /// Such a tick is given up only when a held message is `patience_ticks` beyond `tick`.
    pub fn expect_backlog(&mut self, tick: u64, patience_ticks: u64) {
        (self.backlog_end, self.patience_ticks) = (tick, patience_ticks);
    }

    /// Adds a message, and passes each deliverable message to `deliver` with the number of ticks
    /// missing before it.
    pub fn offer(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        let tick = message.tick();
        if tick < self.sequence.next_tick {
            let last = (self.epoch, self.sequence.publisher);
            return self.sequence.reject(last == (message.epoch(), message.incarnation()));
        }
        if self.is_superseded(&message) {
            return self.sequence.reject(false);
        }
        let waits = tick > self.sequence.next_tick && self.may_have_predecessor(&message);
        if self.held.is_empty() && !waits {
            return self.deliver(message, deliver);
        }
        self.hold(message);
        while let Some(first) = self.held.first_entry() {
            let next_tick = self.sequence.next_tick;
            let due = *first.key() <= if waits { next_tick } else { tick.max(next_tick) };
            if !due && !self.is_overdue() {
                break;
            }
            if let Some((_, message)) = self.held.pop_first() {
                self.deliver(message, deliver);
            }
        }
    }

    /// Delivers all held messages, because no more will arrive.
    pub fn finish(&mut self, deliver: &mut dyn FnMut(M, u64)) {
        while let Some((_, message)) = self.held.pop_first() {
            self.deliver(message, deliver);
        }
    }

    /// Returns the epoch of the last delivered message, or the initial epoch before the first
    /// delivery.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the position and counters of the stream.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// Returns the number of messages that are waiting for earlier ticks.
    pub fn held(&self) -> usize {
        self.held.len()
    }

    fn is_superseded(&self, message: &M) -> bool {
        message.epoch() < self.epoch
    }

    /// Returns `true` if another publisher may still send a tick before this message.
    ///
    /// This is ruled out only if the message has the same publisher as the last delivered message
    /// and no newer epoch than that message. While the start is unknown, the epoch alone decides.
    fn may_have_predecessor(&self, message: &M) -> bool {
        message.epoch() > self.epoch || !self.start_unknown && self.sequence.publisher != message.incarnation()
    }

    /// Holds a message. Of two messages with the same tick, the one with the higher epoch is kept.
    fn hold(&mut self, message: M) {
        match self.held.get(&message.tick()) {
            Some(held) if (held.epoch(), held.incarnation()) == (message.epoch(), message.incarnation()) => {
                self.sequence.reject(true);
            }
            Some(held) if held.epoch() >= message.epoch() => self.sequence.reject(false),
            Some(_) => {
                self.sequence.reject(false);
                self.held.insert(message.tick(), message);
            }
            None => {
                self.held.insert(message.tick(), message);
            }
        }
    }

    /// Returns `true` if the held messages are so far ahead that the next tick is no longer
    /// awaited.
    fn is_overdue(&self) -> bool {
        let Self { backlog_end, patience_ticks, lateness_ticks, .. } = *self;
        let next_tick = self.sequence.next_tick;
        let in_backlog = next_tick < backlog_end;
        let (from, limit) = if in_backlog { (backlog_end, patience_ticks) } else { (next_tick, lateness_ticks) };
        self.held.last_key_value().is_some_and(|(newest, _)| newest.saturating_sub(from) >= limit)
    }

    fn deliver(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        if self.is_superseded(&message) {
            return self.sequence.reject(false);
        }
        let missing = self.sequence.advance(message.tick());
        self.sequence.publisher = message.incarnation();
        (self.epoch, self.start_unknown) = (message.epoch(), false);
        deliver(message, missing);
    }
}
