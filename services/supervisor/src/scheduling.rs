//! Which process runs first where more is to be done than there are processors.
//!
//! Input: a process and its standing. Output: its priority. Time: none. Failure: where a priority cannot be had the process runs all the
//! same, as the kernel has it.
//!
//! A process that starts or ends computes for some ten milliseconds, and a tick that waits for a processor would wait for a whole slice of that, some milliseconds.
//! Whoever is on the path has therefore the shortest slices that the kernel knows (Linux 6.12 and later let it run at once when it is
//! woken; others ignore it), and whoever starts beside the path or leaves it is nicer than the others. A policy that somebody chose for
//! the whole system, such as `chrt --fifo`, stays that of the path.

use std::io;

use rustix::{
    process::{Resource, getrlimit},
    thread::{CapabilitySet, capabilities},
};

/// The shortest slice, ns; a tick takes less.
const SHORT_NS: u64 = 100_000;
/// That of the supervisor, ns: after the path, before everybody else, who has milliseconds.
const SUPERVISOR_NS: u64 = 1_000_000;
/// By how much a process beside the path is nicer: a tenth of the weight, so that it starts on a loaded machine too.
const NICER: i32 = 10;
const NICEST: i32 = 19;
/// To the kernel, the thread that asks.
pub(crate) const OWN: u32 = 0;

/// Standings of processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SchedulingClass {
    /// On the path: it runs when it is woken.
    Path,
    /// Beside the path, like any other program.
    Beside,
    /// It starts, to be on the path later: the path runs first.
    Starting,
    /// It leaves for good, or clears up after one that has: likewise.
    Leaving,
}

/// Gives a process, or the thread that asks, its standing. One that starts and could not be given the path's again is no nicer than others.
pub(crate) fn set(pid: u32, class: SchedulingClass) {
    let Ok(own) = scheduling_of(OWN) else { return };
    let class = if class == SchedulingClass::Starting && !may_return(&own) { SchedulingClass::Beside } else { class };
    // One that has just ended needs no priority, and a kernel that does not know slices goes without.
    let _ = schedule(pid, &attributes(own, class));
}

/// The supervisor sees in time who is silent, whatever else the machine has to do.
pub(crate) fn set_own() {
    let Ok(own) = scheduling_of(OWN) else { return };
    if own.sched_policy == libc::SCHED_OTHER as u32 {
        let _ = schedule(OWN, &libc::sched_attr { sched_runtime: SUPERVISOR_NS, ..own });
    }
}

/// What a process is to have, where the supervisor has `own`.
fn attributes(own: libc::sched_attr, class: SchedulingClass) -> libc::sched_attr {
    let usual = own.sched_policy == libc::SCHED_OTHER as u32;
    match class {
        SchedulingClass::Path if usual => libc::sched_attr { sched_runtime: SHORT_NS, ..own },
        SchedulingClass::Beside if usual => libc::sched_attr { sched_runtime: 0, ..own },
        SchedulingClass::Path | SchedulingClass::Beside => own,
        SchedulingClass::Starting | SchedulingClass::Leaving => libc::sched_attr {
            sched_policy: libc::SCHED_OTHER as u32,
            sched_nice: (own.sched_nice + NICER).min(NICEST),
            sched_priority: 0,
            sched_runtime: 0,
            ..own
        },
    }
}

/// A process that was made nicer may have back what the supervisor has.
fn may_return(own: &libc::sched_attr) -> bool {
    let allowed = |resource| getrlimit(resource).current.unwrap_or(u64::MAX);
    capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::SYS_NICE))
        // The kernel counts niceness from 20 downwards there.
        || (allowed(Resource::Nice) >= u64::from((20 - own.sched_nice).unsigned_abs())
            && allowed(Resource::Rtprio) >= u64::from(own.sched_priority))
}

fn schedule(pid: u32, attributes: &libc::sched_attr) -> io::Result<()> {
    #[allow(unsafe_code)]
    // SAFETY: the kernel reads as many bytes as the structure says that it has, and writes none.
    let answer = unsafe { libc::syscall(libc::SYS_sched_setattr, pid, std::ptr::from_ref(attributes), 0) };
    if answer == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// How a process is scheduled.
fn scheduling_of(pid: u32) -> io::Result<libc::sched_attr> {
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
    // SAFETY: the kernel writes no more than the `size` bytes that it is told of, and all of them are integers.
    let answer = unsafe { libc::syscall(libc::SYS_sched_getattr, pid, &raw mut attributes, size, 0) };
    if answer == 0 { Ok(attributes) } else { Err(io::Error::last_os_error()) }
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

        /// Policy, niceness, slice.
        fn under(&self, class: SchedulingClass) -> (u32, i32, u64) {
            set(self.0.id(), class);
            let now = scheduling_of(self.0.id()).unwrap();
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
    fn whoever_starts_or_leaves_is_nicer_and_whoever_is_on_the_path_has_short_slices() {
        let own = scheduling_of(OWN).unwrap();
        let (sleeper, policy) = (Sleeper::new(), libc::SCHED_OTHER as u32);
        assert_eq!(own.sched_policy, policy, "the test runs under a policy of its own");
        let nicer = (own.sched_nice + NICER).min(NICEST);
        // Before 6.12 the kernel says 0 at all times.
        let short_ns = if own.sched_runtime == 0 { 0 } else { SHORT_NS };
        assert_eq!(sleeper.under(SchedulingClass::Path), (policy, own.sched_nice, short_ns));
        if may_return(&own) {
            assert_eq!(sleeper.under(SchedulingClass::Starting), (policy, nicer, own.sched_runtime));
        } else {
            assert_eq!(sleeper.under(SchedulingClass::Starting), (policy, own.sched_nice, own.sched_runtime));
        }
        assert_eq!(sleeper.under(SchedulingClass::Path), (policy, own.sched_nice, short_ns));
        assert_eq!(sleeper.under(SchedulingClass::Beside), (policy, own.sched_nice, own.sched_runtime));
        assert_eq!(sleeper.under(SchedulingClass::Leaving), (policy, nicer, own.sched_runtime));
    }

    #[test]
    fn a_policy_that_somebody_chose_is_that_of_the_path_only() {
        let own = scheduling_of(OWN).unwrap();
        let chosen = libc::sched_attr { sched_policy: libc::SCHED_FIFO as u32, sched_priority: 20, ..own };
        assert_eq!(attributes(chosen, SchedulingClass::Path).sched_priority, 20);
        assert_eq!(attributes(chosen, SchedulingClass::Beside).sched_priority, 20);
        let starting = attributes(chosen, SchedulingClass::Starting);
        assert_eq!((starting.sched_policy, starting.sched_priority), (libc::SCHED_OTHER as u32, 0));
    }
}
