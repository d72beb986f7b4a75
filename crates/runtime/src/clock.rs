//! Monotonic clock, its offset to the time of day, and processor time.
//!
//! These clocks are used for timestamps, waits, pacing and statistics. No output depends on them.

use std::fs;

use rustix::{
    thread::clock_nanosleep_absolute,
    time::{ClockId, Timespec, clock_gettime},
};

/// Returns the time on CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Returns CLOCK_REALTIME minus CLOCK_MONOTONIC, ns. The offset changes when the clock is set.
pub fn realtime_offset_ns() -> i64 {
    let realtime = clock_gettime(ClockId::Realtime);
    realtime.tv_sec * 1_000_000_000 + realtime.tv_nsec - monotonic_ns().cast_signed()
}

/// Sleeps until CLOCK_MONOTONIC reaches `at_ns`. A signal can end the sleep early.
pub fn sleep_until_ns(at_ns: u64) {
    let _ = clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &timespec(at_ns));
}

/// Returns a time on CLOCK_MONOTONIC, ns, as the kernel's type.
pub(crate) fn timespec(at_ns: u64) -> Timespec {
    Timespec { tv_sec: (at_ns / 1_000_000_000) as i64, tv_nsec: (at_ns % 1_000_000_000) as i64 }
}

/// Returns the processor time in ns used so far by the live threads of a process, or `None` if the
/// process does not exist.
pub fn cpu_time_ns(pid: u32) -> Option<u64> {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).ok()?;
    let used_ns = threads.flatten().filter_map(|thread| {
        // A thread that exits during the loop is not counted.
        let text = fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    Some(used_ns.sum())
}
