//! Seeded random numbers, and links with random delays.

use std::collections::VecDeque;

/// Random number generator SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Debug, Clone)]
pub(crate) struct SimRng(pub(crate) u64);

impl SimRng {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number from `low` to `high`, both included.
    pub(crate) fn in_range(&mut self, low: u64, high: u64) -> u64 {
        low + self.next() % (high - low + 1)
    }

    /// Returns `true` with the probability `per_mille` / 1000.
    pub(crate) fn chance(&mut self, per_mille: u64) -> bool {
        self.next() % 1000 < per_mille
    }
}

/// Ordered, lossless link between two processes, with a random delay for each message.
#[derive(Debug, Clone)]
pub(crate) struct Link<T> {
    queue: VecDeque<(u64, T)>,
    delay_ms: u64,
    last_ms: u64,
}

/// Upper limit of the regular delay of a link, ms.
pub(crate) const MAX_DELAY_MS: u64 = 10;
/// Maximum delay of an exceptionally late message, ms.
const MAX_STRAY_DELAY_MS: u64 = 25;

impl<T> Link<T> {
    pub(crate) fn new(longest_ms: u64, rng: &mut SimRng) -> Self {
        Self { queue: VecDeque::new(), delay_ms: rng.in_range(0, longest_ms), last_ms: 0 }
    }

    pub(crate) fn send(&mut self, now_ms: u64, rng: &mut SimRng, message: T) {
        let delay_ms = if rng.chance(3) { self.delay_ms.max(MAX_STRAY_DELAY_MS) } else { self.delay_ms };
        self.last_ms = self.last_ms.max(now_ms + rng.in_range(0, delay_ms));
        self.queue.push_back((self.last_ms, message));
    }

    pub(crate) fn arrived(&mut self, now_ms: u64) -> Option<T> {
        self.queue.pop_front_if(|(due_ms, _)| *due_ms <= now_ms).map(|(_, message)| message)
    }
}
