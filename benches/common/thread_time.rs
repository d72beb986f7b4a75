//! CPU time of the current thread.

use rustix::time::{ClockId, clock_gettime};

/// Returns the CPU time of this thread, ns. Time used by other threads is not included.
pub(crate) fn thread_cpu_ns() -> i64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}
