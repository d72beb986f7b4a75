//! Scheduling priorities, for machines with more runnable processes than processors.
//!
//! - Input: a process and its class.
//! - Output: its scheduling attributes.
//! - Failure: if the attributes cannot be set, the process keeps its previous ones.
//!
//! A process that starts or exits computes for tens of milliseconds. A tick that waits for a
//! processor would wait for a whole time slice of that process, which lasts a few milliseconds.
//! Processes on the data path therefore have the shortest slices. Linux 6.12 and later then run
//! them as soon as they are woken; earlier versions ignore the slice. Starting candidates and
//! exiting processes have an increased nice value.
//!
//! If the supervisor was started with a policy other than the default, for example by `chrt
//! --fifo`, that policy also applies to the data path and to auxiliary processes. Starting and
//! exiting processes have the default policy.

use std::io;

use rustix::{
    process::{Resource, getrlimit},
    thread::{CapabilitySet, capabilities},
};

/// Time slice of processes on the data path, ns. Processing one tick takes less time than this. It
/// is the shortest slice that Linux supports.
const PATH_SLICE_NS: u64 = 100_000;
/// Time slice of the supervisor, ns. It is longer than on the data path, but shorter than the
/// kernel's default of a few milliseconds.
const SUPERVISOR_SLICE_NS: u64 = 1_000_000;
/// Increase of the nice value for starting and exiting processes.
///
/// The increase reduces a process's scheduling weight to a tenth, which still allows the process to
/// start on a loaded machine.
const NICE_INCREMENT: i32 = 10;
const MAX_NICE: i32 = 19;
/// Process ID that denotes the calling thread.
pub(crate) const CALLING_THREAD: u32 = 0;

/// Scheduling class of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SchedulingClass {
    /// Process of the data path, which runs as soon as it is woken.
    Path,
    /// Auxiliary process with default scheduling.
    Auxiliary,
    /// Candidate that is starting, with a lower priority than the data path.
    Starting,
    /// Process that is exiting, or thread that reaps one, with a lower priority than the data path.
    Leaving,
}

/// Sets the scheduling of a process or of the calling thread.
///
/// The priority of a starting process is not lowered if it could not be restored later.
pub(crate) fn set_class(pid: u32, class: SchedulingClass) {
    let Ok(own) = attributes_of(CALLING_THREAD) else { return };
    let class =
        if class == SchedulingClass::Starting && !can_restore(&own) { SchedulingClass::Auxiliary } else { class };
    // An error is ignored, because it means that the process has just exited or that the kernel
    // does not support slices.
    let _ = schedule(pid, &attributes(own, class));
}

/// Shortens the time slice of the supervisor, so that it detects silent services on a loaded
/// machine.
pub(crate) fn set_supervisor_slice() {
    let Ok(own) = attributes_of(CALLING_THREAD) else { return };
    if own.sched_policy == libc::SCHED_OTHER as u32 {
        let _ = schedule(CALLING_THREAD, &libc::sched_attr { sched_runtime: SUPERVISOR_SLICE_NS, ..own });
    }
}

/// Returns the attributes of a class, given those of the supervisor in `own`.
fn attributes(own: libc::sched_attr, class: SchedulingClass) -> libc::sched_attr {
    let is_default = own.sched_policy == libc::SCHED_OTHER as u32;
    match class {
        SchedulingClass::Path if is_default => libc::sched_attr { sched_runtime: PATH_SLICE_NS, ..own },
        SchedulingClass::Auxiliary if is_default => libc::sched_attr { sched_runtime: 0, ..own },
        SchedulingClass::Path | SchedulingClass::Auxiliary => own,
        SchedulingClass::Starting | SchedulingClass::Leaving => libc::sched_attr {
            sched_policy: libc::SCHED_OTHER as u32,
            sched_nice: (own.sched_nice + NICE_INCREMENT).min(MAX_NICE),
            sched_priority: 0,
            sched_runtime: 0,
            ..own
        },
    }
}

/// Returns `true` if the supervisor is permitted to restore the priority of a process after
/// lowering it. `own` are the attributes of the supervisor.
fn can_restore(own: &libc::sched_attr) -> bool {
    let allowed = |resource| getrlimit(resource).current.unwrap_or(u64::MAX);
    capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::SYS_NICE))
        // RLIMIT_NICE is 20 minus the lowest permitted nice value.
        || (allowed(Resource::Nice) >= u64::from((20 - own.sched_nice).unsigned_abs())
            && allowed(Resource::Rtprio) >= u64::from(own.sched_priority))
}

fn schedule(pid: u32, attributes: &libc::sched_attr) -> io::Result<()> {
    #[allow(unsafe_code)]
    // SAFETY: the kernel reads as many bytes as the structure declares, and writes nothing.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, pid, std::ptr::from_ref(attributes), 0) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Returns the scheduling attributes of a process.
fn attributes_of(pid: u32) -> io::Result<libc::sched_attr> {
    let size = size_of::<libc::sched_attr>() as u32;
    let mut attributes = libc::sched_attr {
        size,
        sched_policy: 0,
        sched_flags: 0,
        sched_nice: 0,
        sched_priority: 0,
        sched_runtime: 0,
        sched_deadline: 0,
        sched_period: 0,
    };
    #[allow(unsafe_code)]
    // SAFETY: the kernel writes at most `size` bytes, and all fields are integers.
    let result = unsafe { libc::syscall(libc::SYS_sched_getattr, pid, &raw mut attributes, size, 0) };
    if result == 0 { Ok(attributes) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use std::process::{Child, Command};

    use super::*;

    struct Sleeper(Child);

    impl Sleeper {
        fn new() -> Self {
            Self(Command::new("sleep").arg("60").spawn().unwrap())
        }

        /// Applies a class and returns policy, nice value and slice.
        fn apply(&self, class: SchedulingClass) -> (u32, i32, u64) {
            set_class(self.0.id(), class);
            let now = attributes_of(self.0.id()).unwrap();
            (now.sched_policy, now.sched_nice, now.sched_runtime)
        }
    }

    impl Drop for Sleeper {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    #[test]
    fn class_sets_nice_value_and_slice() {
        let own = attributes_of(CALLING_THREAD).unwrap();
        let (sleeper, policy) = (Sleeper::new(), libc::SCHED_OTHER as u32);
        assert_eq!(own.sched_policy, policy, "this test requires the default policy");
        let nice = (own.sched_nice + NICE_INCREMENT).min(MAX_NICE);
        // Kernels before 6.12 always report a slice of 0.
        let supported = |slice_ns| if own.sched_runtime == 0 { 0 } else { slice_ns };
        let slice_ns = supported(PATH_SLICE_NS);
        assert_eq!(sleeper.apply(SchedulingClass::Path), (policy, own.sched_nice, slice_ns));
        if can_restore(&own) {
            assert_eq!(sleeper.apply(SchedulingClass::Starting), (policy, nice, own.sched_runtime));
        } else {
            assert_eq!(sleeper.apply(SchedulingClass::Starting), (policy, own.sched_nice, own.sched_runtime));
        }
        assert_eq!(sleeper.apply(SchedulingClass::Path), (policy, own.sched_nice, slice_ns));
        assert_eq!(sleeper.apply(SchedulingClass::Auxiliary), (policy, own.sched_nice, own.sched_runtime));
        assert_eq!(sleeper.apply(SchedulingClass::Leaving), (policy, nice, own.sched_runtime));
    }

    #[test]
    fn custom_policy_applies_to_path_and_auxiliary_only() {
        let own = attributes_of(CALLING_THREAD).unwrap();
        let chosen = libc::sched_attr { sched_policy: libc::SCHED_FIFO as u32, sched_priority: 20, ..own };
        assert_eq!(attributes(chosen, SchedulingClass::Path).sched_priority, 20);
        assert_eq!(attributes(chosen, SchedulingClass::Auxiliary).sched_priority, 20);
        let starting = attributes(chosen, SchedulingClass::Starting);
        assert_eq!((starting.sched_policy, starting.sched_priority), (libc::SCHED_OTHER as u32, 0));
    }
}
