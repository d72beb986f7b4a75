//! Two that take turns, on one processor: neither then wakes another processor for each answer, which takes four times as long.
//!
//! Input: none. Output: while the value lives, this thread and what it starts keep to one processor. Time: none. Failure: where the
//! system refuses, nothing changes.

use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Gives back what was allowed before when it goes.
pub(crate) struct OneProcessor {
    before: Option<CpuSet>,
}

impl OneProcessor {
    /// The one that this thread is on now.
    pub(crate) fn keep_to() -> Self {
        let mut one = CpuSet::new();
        one.set(sched_getcpu());
        let before = sched_getaffinity(None).ok().filter(|_| sched_setaffinity(None, &one).is_ok());
        Self { before }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_one_processor_while_it_lives_and_all_that_were_allowed_later() {
        let allowed = || sched_getaffinity(None).map(|set| set.count()).ok();
        let before = allowed();
        {
            let _one = OneProcessor::keep_to();
            assert_eq!(allowed(), Some(1));
        }
        assert_eq!(allowed(), before);
    }
}
