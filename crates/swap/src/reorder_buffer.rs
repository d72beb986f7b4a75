//! One stream out of all that publish a topic: each tick once, in order.
//!
//! Input: messages, in order for each publisher and in any order across them. Output: messages in the order of ticks, each with the
//! number of ticks missing before it. Time: none; how long to wait is counted in ticks. Failure: what stays away is left out and counted.

use std::collections::BTreeMap;

use crate::{Sequence, Stamped};

/// The reading end of a topic.
#[derive(Debug, Clone)]
pub struct ReorderBuffer<M> {
    lateness_ticks: u64,
    /// Before this tick everything has been published, and is on its way,
    expected_until: u64,
    /// and is given up once the stream is so far beyond it.
    patience_ticks: u64,
    sequence: Sequence,
    /// The decision under which the message delivered last was published; before the first, the one in force.
    epoch: u32,
    /// A stream whose first message may have any tick.
    joining: bool,
    held: BTreeMap<u64, M>,
}

impl<M: Stamped> ReorderBuffer<M> {
    /// A reader whose first tick is known: 0 for one that is there before the stream begins, or where its checkpoint ends. `epoch` is
    /// the decision in force, or that of the last message before the checkpoint.
    ///
    /// A message before which another publisher's may still come waits until the stream is `lateness_ticks` ahead. Before its first
    /// message the reader knows no publisher, so that may be any message.
    pub fn starting(next_tick: u64, epoch: u32, lateness_ticks: u64) -> Self {
        let sequence = Sequence { next_tick, ..Sequence::default() };
        let (expected_until, patience_ticks, joining) = (0, lateness_ticks, false);
        Self { lateness_ticks, expected_until, patience_ticks, sequence, epoch, joining, held: BTreeMap::new() }
    }

    /// A reader that joins a stream under way, with `epoch` in force: the first message of that decision is delivered at once,
    /// whatever its tick, and ticks before it count as lost.
    pub fn joining(epoch: u32, lateness_ticks: u64) -> Self {
        Self { joining: true, ..Self::starting(0, epoch, lateness_ticks) }
    }

    /// Before `tick` everything has been published: what is missing there is given up once the stream is `patience_ticks` beyond it.
    pub fn expect_until(&mut self, tick: u64, patience_ticks: u64) {
        (self.expected_until, self.patience_ticks) = (tick, patience_ticks);
    }

    /// Takes a message; hands every message that has its turn, with the number of ticks missing before it, to `deliver`.
    pub fn offer(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        let tick = message.tick();
        if tick < self.sequence.next_tick {
            let last = (self.epoch, self.sequence.sender);
            return self.sequence.refuse(last == (message.epoch(), message.incarnation()));
        }
        if self.is_superseded(&message) {
            return self.sequence.refuse(false);
        }
        let waits = tick > self.sequence.next_tick && self.may_be_filled(&message);
        if self.held.is_empty() && !waits {
            return self.deliver(message, deliver);
        }
        self.hold(message);
        while let Some(first) = self.held.first_entry() {
            let next_tick = self.sequence.next_tick;
            let due = *first.key() <= if waits { next_tick } else { tick.max(next_tick) };
            if !due && !self.overdue() {
                break;
            }
            if let Some((_, message)) = self.held.pop_first() {
                self.deliver(message, deliver);
            }
        }
    }

    /// Hands over every message that still waits: nothing more comes.
    pub fn finish(&mut self, deliver: &mut dyn FnMut(M, u64)) {
        while let Some((_, message)) = self.held.pop_first() {
            self.deliver(message, deliver);
        }
    }

    /// The decision under which the message delivered last was published; before the first, the one in force.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The stream so far.
    pub fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    /// Messages that wait for ticks before them.
    pub fn held(&self) -> usize {
        self.held.len()
    }

    fn is_superseded(&self, message: &M) -> bool {
        message.epoch() < self.epoch
    }

    /// Another publisher may still send what is missing before this message: only the publisher delivered last, under the same
    /// decision, is known to have nothing in between.
    fn may_be_filled(&self, message: &M) -> bool {
        message.epoch() > self.epoch || !self.joining && self.sequence.sender != message.incarnation()
    }

    /// Keeps a message; of two with the same tick that of the later decision.
    fn hold(&mut self, message: M) {
        match self.held.get(&message.tick()) {
            Some(held) if (held.epoch(), held.incarnation()) == (message.epoch(), message.incarnation()) => {
                self.sequence.refuse(true);
            }
            Some(held) if held.epoch() >= message.epoch() => self.sequence.refuse(false),
            Some(_) => {
                self.sequence.refuse(false);
                self.held.insert(message.tick(), message);
            }
            None => {
                self.held.insert(message.tick(), message);
            }
        }
    }

    /// A message has waited as long as any may.
    fn overdue(&self) -> bool {
        let Self { expected_until, patience_ticks, lateness_ticks, .. } = *self;
        let next_tick = self.sequence.next_tick;
        let is_expected = next_tick < expected_until;
        let (from, limit) = if is_expected { (expected_until, patience_ticks) } else { (next_tick, lateness_ticks) };
        self.held.last_key_value().is_some_and(|(newest, _)| newest.saturating_sub(from) >= limit)
    }

    fn deliver(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        if self.is_superseded(&message) {
            return self.sequence.refuse(false);
        }
        let missing = self.sequence.pass(message.tick());
        self.sequence.sender = message.incarnation();
        (self.epoch, self.joining) = (message.epoch(), false);
        deliver(message, missing);
    }
}
