//! A stream in the order of ticks: what is next, what is missing, what came again.

use messages::{Flags, Header};

/// A stream in the order of ticks: what is next, what is missing, what came again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    /// The tick that comes next when nothing is lost.
    pub next_tick: u64,
    /// Ticks in the stream.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Messages left out because their sender sent them again, or too late.
    pub duplicated: u64,
    /// Messages left out because another sender had sent their tick, or owns it.
    pub repeated: u64,
    /// The incarnation that sent the last tick; 0 before the first.
    pub sender: u32,
}

impl Sequence {
    /// Admits a tick to the stream and tells how many before it are missing; `None` for one that has had its turn.
    pub fn admit(&mut self, header: &Header) -> Option<u64> {
        if header.tick < self.next_tick {
            self.refuse(header.incarnation == self.sender);
            return None;
        }
        self.sender = header.incarnation;
        Some(self.pass(header.tick))
    }

    /// Leaves out a message. Twice the same of one sender is a fault; what another one says again is none.
    pub fn refuse(&mut self, same_sender: bool) {
        let count = if same_sender { &mut self.duplicated } else { &mut self.repeated };
        *count += 1;
    }

    /// Counts a tick that has its turn and tells how many before it are missing.
    pub fn pass(&mut self, tick: u64) -> u64 {
        let missing = tick.saturating_sub(self.next_tick);
        self.lost += missing;
        self.ticks += 1;
        self.next_tick = tick.saturating_add(1);
        missing
    }

    /// A header of the tick just admitted that says what is missing before it.
    pub fn mark(&self, header: Header, missing: u64) -> Header {
        let flags = header.flags | Flags::LOST_BEFORE.when(missing > 0);
        Header { lost_upstream: self.lost, flags, ..header }
    }
}
