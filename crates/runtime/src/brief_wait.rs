//! Yields of the processor to other services, limited if they do not help.
//!
//! - The inputs of a tick are published within microseconds of each other. A service whose slot
//!   waits for [the rest of a tick](crate::SlotProcessor::has_incomplete_tick) yields the processor
//!   until it arrives, because a sleep and a wake-up take longer.
//! - The kernel starts some of the subscribers of a sample on the processor of `ingest`. `ingest`
//!   yields to them before it computes the next sample.
//!
//! If another program needs the processor, a yield can last for milliseconds. A sleep would not,
//! because the kernel favours tasks that wake up. Yields are therefore suspended after a long one.
//! They are also suspended after several waits in a row without a message, for example because an
//! input comes from another host.

use std::{thread, time::Duration};

use crate::clock::monotonic_ns;

/// Maximum number of yields in a wait. On an idle processor they last for about 40 µs. At 1 kHz on
/// two processors, one wait in 500 ends without a message; with a quarter of the yields, it is one
/// in 20.
const MAX_YIELDS: u32 = 80;
/// Duration after which a wait ends and yields are suspended.
const LONG_WAIT: Duration = Duration::from_micros(500);
/// Number of successive waits without a message after which yields are suspended.
const MAX_FAILED_WAITS: u32 = 8;
/// Time for which yields are suspended.
const SUSPENSION: Duration = Duration::from_millis(100);

/// Brief waits of a service.
#[derive(Debug, Default)]
pub struct BriefWait {
    /// Time until which yields are suspended, CLOCK_MONOTONIC, ns.
    suspended_until_ns: u64,
    /// Number of successive waits that ended without a message.
    failed_waits: u32,
}

impl BriefWait {
    /// Yields the processor once, unless yields are suspended.
    pub fn yield_once(&mut self) {
        self.wait(|| true);
    }

    /// Yields until `is_published` returns `true`. Returns `false` if it has not by the end of the
    /// wait.
    pub(crate) fn wait(&mut self, is_published: impl Fn() -> bool) -> bool {
        self.wait_with(thread::yield_now, monotonic_ns, is_published)
    }

    fn wait_with(&mut self, yield_now: impl Fn(), now_ns: impl Fn() -> u64, is_published: impl Fn() -> bool) -> bool {
        let start_ns = now_ns();
        if start_ns < self.suspended_until_ns {
            return false;
        }
        let (mut published, mut is_long, mut yields) = (false, false, 0);
        let mut end_ns = start_ns;
        while !published && !is_long && yields < MAX_YIELDS {
            yield_now();
            yields += 1;
            end_ns = now_ns();
            is_long = u128::from(end_ns - start_ns) > LONG_WAIT.as_nanos();
            published = is_published();
        }
        self.failed_waits = if published { 0 } else { self.failed_waits + 1 };
        if is_long || self.failed_waits >= MAX_FAILED_WAITS {
            self.suspended_until_ns = end_ns + SUSPENSION.as_nanos() as u64;
            self.failed_waits = 0;
        }
        published
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Clock that advances by `yield_us` with each yield.
    struct Clock {
        yield_us: u64,
        now_us: Cell<u64>,
        yields: Cell<u32>,
    }

    impl Clock {
        fn new(yield_us: u64) -> Self {
            Self { yield_us, now_us: Cell::new(1), yields: Cell::new(0) }
        }

        /// Waits for a message that is published with the yield number `published_at`. Returns
        /// whether the wait saw it, and the number of yields.
        fn wait(&self, brief_wait: &mut BriefWait, published_at: u32) -> (bool, u32) {
            self.yields.set(0);
            let yield_now = || {
                self.yields.set(self.yields.get() + 1);
                self.now_us.set(self.now_us.get() + self.yield_us);
            };
            let is_published = || self.yields.get() >= published_at;
            let published = brief_wait.wait_with(yield_now, || self.now_us.get() * 1000, is_published);
            (published, self.yields.get())
        }
    }

    #[test]
    fn wait_ends_when_message_is_published() {
        assert_eq!(Clock::new(1).wait(&mut BriefWait::default(), 3), (true, 3));
    }

    #[test]
    fn wait_without_message_is_limited() {
        assert_eq!(Clock::new(1).wait(&mut BriefWait::default(), u32::MAX), (false, MAX_YIELDS));
        assert_eq!(Clock::new(200).wait(&mut BriefWait::default(), u32::MAX), (false, 3));
    }

    #[test]
    fn long_yield_suspends_yields() {
        let (mut brief_wait, clock) = (BriefWait::default(), Clock::new(501));
        assert_eq!(clock.wait(&mut brief_wait, 1), (true, 1));
        assert_eq!(clock.wait(&mut brief_wait, 1), (false, 0));
        clock.now_us.set(clock.now_us.get() + 100_000);
        assert_eq!(clock.wait(&mut brief_wait, 1), (true, 1));
    }

    #[test]
    fn successive_waits_without_message_suspend_yields() {
        let (mut brief_wait, clock) = (BriefWait::default(), Clock::new(1));
        for _ in 1..MAX_FAILED_WAITS {
            assert_eq!(clock.wait(&mut brief_wait, u32::MAX), (false, MAX_YIELDS));
        }
        assert_eq!(clock.wait(&mut brief_wait, 1), (true, 1));
        for _ in 0..MAX_FAILED_WAITS {
            assert_eq!(clock.wait(&mut brief_wait, u32::MAX), (false, MAX_YIELDS));
        }
        assert_eq!(clock.wait(&mut brief_wait, 1), (false, 0));
    }
}
