//! Chance from a seed, and links that delay by it.

use std::collections::VecDeque;

/// SplitMix64 (Steele, Lea, Flood 2014): the same numbers for the same seed.
#[derive(Debug, Clone)]
pub(crate) struct Chance(pub(crate) u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number from `low` to `high`, both included.
    pub(crate) fn between(&mut self, low: u64, high: u64) -> u64 {
        low + self.next() % (high - low + 1)
    }

    /// True `per_mille` times in a thousand.
    pub(crate) fn happens(&mut self, per_mille: u64) -> bool {
        self.next() % 1000 < per_mille
    }
}

/// A way from one process to another: in order, nothing lost, each message delayed by chance.
#[derive(Debug, Clone)]
pub(crate) struct Link<T> {
    queue: VecDeque<(u64, T)>,
    delay_ms: u64,
    last_ms: u64,
}

/// Longest usual delay, ms.
pub(crate) const DELAY_MS: u64 = 10;
/// Longest delay of a stray message, ms.
const STRAY_MS: u64 = 25;

impl<T> Link<T> {
    pub(crate) fn new(longest_ms: u64, chance: &mut Chance) -> Self {
        Self { queue: VecDeque::new(), delay_ms: chance.between(0, longest_ms), last_ms: 0 }
    }

    pub(crate) fn send(&mut self, now_ms: u64, chance: &mut Chance, message: T) {
        let delay_ms = if chance.happens(3) { self.delay_ms.max(STRAY_MS) } else { self.delay_ms };
        self.last_ms = self.last_ms.max(now_ms + chance.between(0, delay_ms));
        self.queue.push_back((self.last_ms, message));
    }

    pub(crate) fn arrived(&mut self, now_ms: u64) -> Option<T> {
        self.queue.pop_front_if(|(due_ms, _)| *due_ms <= now_ms).map(|(_, message)| message)
    }
}
