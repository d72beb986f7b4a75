//! Position and counters of a stream of ticks.

use attitude::state_words::StateWords;
use messages::{Flags, Header};

/// Position and counters of a stream of ticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    /// Next tick if none is lost.
    pub next_tick: u64,
    /// Number of delivered ticks.
    pub ticks: u64,
    /// Number of ticks that were skipped.
    pub lost: u64,
    /// Number of messages discarded because the same publisher had already sent the tick, or
    /// because the tick arrived after it had been given up.
    pub duplicated: u64,
    /// Number of messages discarded because another publisher had already sent the tick or owns the
    /// tick.
    pub repeated: u64,
    /// Incarnation that published the last tick; 0 before the first tick.
    pub publisher: u32,
}

impl Sequence {
    /// Admits a tick and returns the number of ticks missing before it. Returns `None` if the tick
    /// was already delivered or skipped.
    pub fn admit(&mut self, header: &Header) -> Option<u64> {
        if header.tick < self.next_tick {
            self.reject(header.incarnation == self.publisher);
            return None;
        }
        self.publisher = header.incarnation;
        Some(self.advance(header.tick))
    }

    /// Counts a discarded message.
    ///
    /// A repetition by the same publisher is a fault. A repetition by another publisher is expected
    /// after a restart or swap.
    pub fn reject(&mut self, same_publisher: bool) {
        let count = if same_publisher { &mut self.duplicated } else { &mut self.repeated };
        *count += 1;
    }

    /// Advances past a tick and returns the number of ticks missing before it.
    pub fn advance(&mut self, tick: u64) -> u64 {
        let missing = tick.saturating_sub(self.next_tick);
        self.lost += missing;
        self.ticks += 1;
        self.next_tick = tick.saturating_add(1);
        missing
    }

    /// Returns the header of the tick just admitted, with the number of lost ticks. If ticks are
    /// missing before it, the header has the flag `LOST_BEFORE`.
    pub fn mark_header(&self, header: Header, missing: u64) -> Header {
        let flags = header.flags | Flags::LOST_BEFORE.when(missing > 0);
        Header { lost_upstream: self.lost, flags, ..header }
    }
}
impl StateWords for Sequence {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        // The publisher is left out. A resumed service reads its inputs again from their oldest
        // message, and repetitions by the last publisher must not count as duplicates.
        let Self { next_tick, ticks, lost, duplicated, repeated, publisher: _ } = self;
        [next_tick, ticks, lost, duplicated, repeated].into_iter().for_each(visit);
    }
}
