//! Two that take turns, on one processor: neither then wakes another processor for each answer, which takes four times as long.
//!
//! Input: none. Output: while the value lives, this thread and what it starts keep to one processor. Time: none. Failure: where the
//! system refuses, nothing changes.

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// Gives back what was allowed before when it goes.
pub(crate) struct OneProcessor {
    before: Option<CpuSet>,
}

impl OneProcessor {
    /// Of those allowed, the one that the process's number gives: judges side by side are spread over them.
    pub(crate) fn keep_to() -> Self {
        let kept = sched_getaffinity(None).ok().filter(|allowed| {
            let place = std::process::id() % allowed.count().max(1);
            let mut one = CpuSet::new();
            (0..CpuSet::MAX_CPU)
                .filter(|cpu| allowed.is_set(*cpu))
                .nth(place as usize)
                .into_iter()
                .for_each(|cpu| one.set(cpu));
            sched_setaffinity(None, &one).is_ok()
        });
        Self { before: kept }
    }
}

impl Drop for OneProcessor {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // It is slower where that fails, and nothing else.
            let _ = sched_setaffinity(None, before);
        }
    }
}
