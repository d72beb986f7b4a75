//! One stream out of all that publish a topic: each tick once, in order.
//!
//! Input: messages, in order for each publisher and in any order across them. Output: messages in the order of ticks, each with the
//! number of ticks missing before it. Time: none; how long to wait is counted in ticks. Failure: what stays away is left out and counted.

use std::collections::BTreeMap;

use crate::Stamped;

/// A stream so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// The tick that comes next when nothing is lost.
    pub next_tick: u64,
    /// Ticks delivered.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Messages left out because their publisher sent them again.
    pub duplicated: u64,
    /// Messages left out because another publisher, or the same under another decision, had sent their tick.
    pub repeated: u64,
    /// Messages left out because a later decision had taken their tick from their publisher.
    pub superseded: u64,
}

/// The reading end of a topic.
#[derive(Debug, Clone)]
pub struct Inlet<M> {
    lateness_ticks: u64,
    counts: Counts,
    /// The decision under which the message delivered last was published; before the first, the one in force.
    epoch: u32,
    /// Who published it, if that is known.
    incarnation: Option<u32>,
    /// A stream whose first message may have any tick.
    joining: bool,
    held: BTreeMap<u64, M>,
}

impl<M: Stamped> Inlet<M> {
    /// A reader whose first tick is known: 0 for one that is there before the stream begins, or where its checkpoint ends. `epoch` is
    /// the decision in force, or that of the last message before the checkpoint.
    ///
    /// A message before which another publisher's may still come waits until the stream is `lateness_ticks` ahead. Before its first
    /// message the reader knows no publisher, so that may be any message.
    pub fn starting(next_tick: u64, epoch: u32, lateness_ticks: u64) -> Self {
        let counts = Counts { next_tick, ..Counts::default() };
        Self { lateness_ticks, counts, epoch, incarnation: None, joining: false, held: BTreeMap::new() }
    }

    /// A reader that joins a stream under way, with `epoch` in force: the first message of that decision is delivered at once,
    /// whatever its tick, and ticks before it count as lost.
    pub fn joining(epoch: u32, lateness_ticks: u64) -> Self {
        Self { joining: true, ..Self::starting(0, epoch, lateness_ticks) }
    }

    /// Takes a message; hands every message that has its turn, with the number of ticks missing before it, to `deliver`.
    pub fn offer(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        let tick = message.tick();
        if tick < self.counts.next_tick {
            match (self.epoch, self.incarnation) == (message.epoch(), Some(message.incarnation())) {
                true => self.counts.duplicated += 1,
                false => self.counts.repeated += 1,
            }
            return;
        }
        if self.is_superseded(&message) {
            self.counts.superseded += 1;
            return;
        }
        let waits = tick > self.counts.next_tick && self.may_be_filled(&message);
        if self.held.is_empty() && !waits {
            return self.deliver(message, deliver);
        }
        self.hold(message);
        while let Some(first) = self.held.first_entry() {
            let next_tick = self.counts.next_tick;
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
    pub fn counts(&self) -> &Counts {
        &self.counts
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
        message.epoch() > self.epoch || !self.joining && self.incarnation != Some(message.incarnation())
    }

    /// Keeps a message; of two with the same tick that of the later decision.
    fn hold(&mut self, message: M) {
        match self.held.get(&message.tick()) {
            Some(held) if (held.epoch(), held.incarnation()) == (message.epoch(), message.incarnation()) => {
                self.counts.duplicated += 1
            }
            Some(held) if held.epoch() >= message.epoch() => self.counts.repeated += 1,
            Some(_) => {
                self.counts.repeated += 1;
                self.held.insert(message.tick(), message);
            }
            None => {
                self.held.insert(message.tick(), message);
            }
        }
    }

    /// A message has waited as long as any may.
    fn overdue(&self) -> bool {
        self.held.last_key_value().is_some_and(|(newest, _)| newest - self.counts.next_tick >= self.lateness_ticks)
    }

    fn deliver(&mut self, message: M, deliver: &mut dyn FnMut(M, u64)) {
        if self.is_superseded(&message) {
            self.counts.superseded += 1;
            return;
        }
        let missing = message.tick() - self.counts.next_tick;
        self.counts.lost += missing;
        self.counts.ticks += 1;
        self.counts.next_tick = message.tick().saturating_add(1);
        (self.epoch, self.incarnation, self.joining) = (message.epoch(), Some(message.incarnation()), false);
        deliver(message, missing);
    }
}
