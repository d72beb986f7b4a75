//! Wait without sleeping for a message that is about to be published.
//!
//! The inputs of a tick are published within microseconds of each other. A service whose slot waits
//! for [the rest of a tick](crate::SlotProcessor::has_incomplete_tick) yields the processor until
//! it arrives, because a sleep and a wake-up take longer.
//!
//! If another program needs the processor, a yield can last for milliseconds. A sleep would not,
//! because the kernel favours tasks that wake up. Yields are therefore suspended after a long one.

use std::time::Duration;

use crate::clock::monotonic_ns;

/// Maximum number of yields in a wait.
const MAX_YIELDS: u32 = 20;
/// Duration after which a wait ends and yields are suspended.
const LONG_WAIT: Duration = Duration::from_micros(500);
/// Time for which yields are suspended after a long wait.
const SUSPENSION: Duration = Duration::from_millis(100);

/// Brief waits of a service.
#[derive(Debug, Default)]
pub(crate) struct BriefWait {
    /// Time until which yields are suspended, CLOCK_MONOTONIC, ns.
    suspended_until_ns: u64,
}

impl BriefWait {
    /// Yields until `is_published` returns `true`. Returns `false` if it has not by the end of the
    /// wait.
    pub(crate) fn wait(&mut self, yield_now: impl Fn(), is_published: impl Fn() -> bool) -> bool {
        let start_ns = monotonic_ns();
        if start_ns < self.suspended_until_ns {
            return false;
        }
        for _ in 0..MAX_YIELDS {
            yield_now();
            let now_ns = monotonic_ns();
            let is_long = u128::from(now_ns - start_ns) > LONG_WAIT.as_nanos();
            if is_long {
                self.suspended_until_ns = now_ns + SUSPENSION.as_nanos() as u64;
            }
            if is_published() {
                return true;
            }
            if is_long {
                return false;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, thread::sleep};

    use super::*;

    #[test]
    fn wait_ends_when_message_is_published() {
        let yields = Cell::new(0);
        let published = BriefWait::default().wait(|| yields.set(yields.get() + 1), || yields.get() == 3);
        assert_eq!((published, yields.get()), (true, 3));
    }

    #[test]
    fn wait_without_message_is_limited() {
        let yields = Cell::new(0);
        let published = BriefWait::default().wait(|| yields.set(yields.get() + 1), || false);
        assert_eq!((published, yields.get()), (false, MAX_YIELDS));
    }

    #[test]
    fn long_yield_suspends_yields() {
        let mut brief_wait = BriefWait::default();
        let yields = Cell::new(0);
        let yield_now = || {
            yields.set(yields.get() + 1);
            sleep(LONG_WAIT * 2);
        };
        assert!(brief_wait.wait(yield_now, || true));
        assert!(!brief_wait.wait(yield_now, || true));
        assert_eq!(yields.get(), 1);
    }
}
