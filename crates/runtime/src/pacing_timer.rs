//! Sleeps at regular intervals.
//!
//! The kernel programs the hardware timer of a processor up to three times per sleep: in the
//! interrupt that ends the sleep, when the idle processor restarts its scheduler tick, and when the
//! next sleep begins. On a virtual machine, each of these takes several microseconds.
//!
//! Before a sleep, a [`PacingTimer`] therefore sets another timer for the end of the following
//! sleep. If this time is before the next scheduler tick, and the thread stays on its processor,
//! the hardware is programmed only in the interrupt.

use std::{num::NonZeroU64, os::fd::OwnedFd, time::Duration};

use rustix::{
    thread::set_current_timer_slack,
    time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create, timerfd_settime},
};

use crate::clock::{monotonic_ns, sleep_until_ns, timespec};

/// Longest interval for which a timer is set in advance, ns. It is the usual period of the
/// scheduler tick. In a longer interval, the tick comes first.
const MAX_INTERVAL_NS: u64 = 4_000_000;
/// Largest difference between two intervals that count as equal, ns. Rounding causes smaller ones.
const TOLERANCE_NS: u64 = 1_000;

/// Timer for the sleeps of a thread that works at regular intervals.
#[derive(Debug)]
pub struct PacingTimer {
    /// Timers for the ends of this sleep and the following one, in any order. Nothing waits for
    /// them. `None` if the kernel cannot create timers; sleeps then merely cost more.
    timers: Option<[OwnedFd; 2]>,
    /// Index of the timer that is set next.
    index: usize,
    intervals: Intervals,
}

/// Prediction of the end of the following sleep.
#[derive(Debug, Default)]
struct Intervals {
    /// End of the previous sleep, CLOCK_MONOTONIC, ns.
    previous_ns: Option<u64>,
    /// Length of the previous interval, ns.
    interval_ns: u64,
}

impl PacingTimer {
    /// Creates the timer, and minimises the timer slack of the calling thread.
    pub fn for_current_thread() -> Self {
        // With the default slack, a sleep can last up to 50 µs too long. If the kernel rejects the
        // request, sleeps are merely less precise.
        let _ = set_current_timer_slack(NonZeroU64::new(1));
        let timer = || timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::CLOEXEC).ok();
        Self { timers: timer().zip(timer()).map(<[_; 2]>::from), index: 0, intervals: Intervals::default() }
    }

    /// Sleeps until CLOCK_MONOTONIC reaches `at_ns`, for at most `limit`. A signal also ends the
    /// sleep.
    pub fn sleep_until_ns(&mut self, at_ns: u64, limit: Duration) {
        if let Some(following_ns) = self.intervals.following_ns(at_ns) {
            self.set_timer(following_ns);
        }
        sleep_until_ns(at_ns.min(monotonic_ns() + limit.as_nanos() as u64));
    }

    fn set_timer(&mut self, at_ns: u64) {
        let Some(timers) = &self.timers else { return };
        let setting = Itimerspec { it_interval: timespec(0), it_value: timespec(at_ns) };
        // If this fails, the following sleep merely costs more.
        let _ = timerfd_settime(&timers[self.index], TimerfdTimerFlags::ABSTIME, &setting);
        self.index = 1 - self.index;
    }
}

impl Intervals {
    /// Returns the expected end of the sleep after the one that ends at `at_ns`. Returns `None` if
    /// the intervals are irregular or too long.
    fn following_ns(&mut self, at_ns: u64) -> Option<u64> {
        // The interval is zero if a signal or the limit ended the previous sleep early.
        let interval_ns = at_ns.checked_sub(self.previous_ns.replace(at_ns)?).filter(|interval_ns| *interval_ns > 0)?;
        let is_regular = interval_ns.abs_diff(std::mem::replace(&mut self.interval_ns, interval_ns)) <= TOLERANCE_NS;
        (is_regular && interval_ns <= MAX_INTERVAL_NS).then_some(at_ns + interval_ns)
    }
}

#[cfg(test)]
mod tests {
    use rustix::event::{PollFd, PollFlags, poll};

    use super::*;

    const INTERVAL_NS: u64 = 1_000_000;
    const LONG: Duration = Duration::from_secs(10);

    /// Returns the predictions for sleeps that end at `ends_ns`.
    fn predictions<const N: usize>(ends_ns: [u64; N]) -> [Option<u64>; N] {
        let mut intervals = Intervals::default();
        ends_ns.map(|at_ns| intervals.following_ns(at_ns))
    }

    #[test]
    fn sleep_lasts_until_given_time() {
        let mut timer = PacingTimer::for_current_thread();
        let start_ns = monotonic_ns();
        for at_ns in (1..20).map(|count| start_ns + count * INTERVAL_NS) {
            timer.sleep_until_ns(at_ns, LONG);
            assert!(monotonic_ns() >= at_ns);
        }
    }

    #[test]
    fn sleep_is_limited() {
        let at_ns = monotonic_ns() + LONG.as_nanos() as u64;
        PacingTimer::for_current_thread().sleep_until_ns(at_ns, Duration::from_millis(1));
        assert!(monotonic_ns() < at_ns);
    }

    #[test]
    fn timers_are_set_in_turn() {
        let mut timer = PacingTimer::for_current_thread();
        let start_ns = monotonic_ns();
        for at_ns in (0..4).map(|count| start_ns + count * INTERVAL_NS) {
            timer.sleep_until_ns(at_ns, LONG);
        }
        for fd in timer.timers.as_ref().unwrap() {
            let mut fds = [PollFd::new(fd, PollFlags::IN)];
            assert_eq!(poll(&mut fds, Some(&timespec(LONG.as_nanos() as u64))), Ok(1), "a timer was not set");
        }
    }

    #[test]
    fn third_regular_sleep_is_followed() {
        assert_eq!(predictions([5000, 7000, 9000, 11_000]), [None, None, Some(11_000), Some(13_000)]);
        assert_eq!(predictions([5000, 7000, 9001, 11_001])[2..], [Some(11_002), Some(13_001)]);
    }

    #[test]
    fn irregular_and_long_intervals_are_not_followed() {
        assert_eq!(predictions([0, 100_000, 250_000, 350_000]), [None; 4]);
        assert_eq!(predictions([0, 5_000_000, 10_000_000]), [None; 3]);
        assert_eq!(predictions([300_000, 200_000, 100_000]), [None; 3]);
    }

    #[test]
    fn sleep_that_ended_early_is_not_an_interval() {
        assert_eq!(predictions([5000, 7000, 7000, 9000, 9000]), [None, None, None, Some(11_000), None]);
    }
}
