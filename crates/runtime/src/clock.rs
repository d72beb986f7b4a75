//! The monotonic clock, how far it is from the time of day, and the time of processors: for stamps, waits, paces and figures, never for a result.

use std::{fs, time::Duration};

use rustix::{
    thread::clock_nanosleep_absolute,
    time::{ClockId, Timespec, clock_gettime},
};

/// CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// CLOCK_REALTIME less CLOCK_MONOTONIC now, ns; it changes where the clock is set.
pub fn realtime_offset_ns() -> i64 {
    let realtime = clock_gettime(ClockId::Realtime);
    realtime.tv_sec * 1_000_000_000 + realtime.tv_nsec - monotonic_ns().cast_signed()
}

/// Sleeps until CLOCK_MONOTONIC reads `at_ns`, but no longer than `limit`; a signal ends it too.
pub fn sleep_until_ns(at_ns: u64, limit: Duration) {
    let latest = monotonic_ns() + limit.as_nanos() as u64;
    let at_ns = at_ns.min(latest);
    let at = Timespec { tv_sec: (at_ns / 1_000_000_000) as i64, tv_nsec: (at_ns % 1_000_000_000) as i64 };
    // Woken early by a signal: the caller looks at the clock again.
    let _ = clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &at);
}

/// Processor time that the threads of a process have had, ns; `None` where there is no such process.
pub fn cpu_ns(pid: u32) -> Option<u64> {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).ok()?;
    let had_ns = threads.flatten().filter_map(|thread| {
        // One that has just ended is not counted.
        let text = fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    Some(had_ns.sum())
}

/// Asks the kernel to end this thread's sleeps on time instead of up to 50 µs late.
pub fn wake_on_time() {
    // A kernel that refuses only makes the sleeps less exact.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}
