//! Pins a thread to one CPU while it exchanges requests with a child process.
//!
//! The two processes run alternately, so one CPU is enough. With two CPUs, each response would have
//! to wake the other CPU and would take four times as long.
//!
//! Failure: without permission the affinity stays unchanged.

use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Guard that pins this thread, and processes started by it, to one CPU. Dropping it restores the
/// previous affinity.
pub(crate) struct SingleCpu {
    previous: Option<CpuSet>,
}

impl SingleCpu {
    /// Pins this thread to the CPU on which it is running.
    pub(crate) fn pin() -> Self {
        let mut cpu = CpuSet::new();
        cpu.set(sched_getcpu());
        let previous = sched_getaffinity(None).ok().filter(|_| sched_setaffinity(None, &cpu).is_ok());
        Self { previous }
    }
}

impl Drop for SingleCpu {
    fn drop(&mut self) {
        if let Some(previous) = &self.previous {
            // If this fails, the thread stays on one CPU, which only makes the following checks
            // slower.
            let _ = sched_setaffinity(None, previous);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn affinity_is_one_cpu_until_drop() {
        let allowed = || sched_getaffinity(None).map(|set| set.count()).ok();
        let before = allowed();
        {
            let _pinned = SingleCpu::pin();
            assert_eq!(allowed(), Some(1));
        }
        assert_eq!(allowed(), before);
    }
}
