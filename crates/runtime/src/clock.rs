//! The monotonic clock: for stamps, waits and paces, never for a result.

use std::time::Duration;

use rustix::{
    thread::clock_nanosleep_absolute,
    time::{ClockId, Timespec, clock_gettime},
};

/// CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Sleeps until CLOCK_MONOTONIC reads `at_ns`, but no longer than `limit`; a signal ends it too.
pub fn sleep_until_ns(at_ns: u64, limit: Duration) {
    let latest = monotonic_ns() + limit.as_nanos() as u64;
    let at_ns = at_ns.min(latest);
    let at = Timespec { tv_sec: (at_ns / 1_000_000_000) as i64, tv_nsec: (at_ns % 1_000_000_000) as i64 };
    // Woken early by a signal: the caller looks at the clock again.
    let _ = clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &at);
}

/// Asks the kernel to end this thread's sleeps on time instead of up to 50 µs late.
pub fn wake_on_time() {
    // A kernel that refuses only makes the sleeps less exact.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}
