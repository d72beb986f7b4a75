//! What this thread has used of the machine.

use rustix::time::{ClockId, clock_gettime};

/// CPU time of this thread, ns: what other processes take does not count.
pub(crate) fn cpu_ns() -> i64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}
