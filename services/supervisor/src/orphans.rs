//! Ends processes that killed services leave behind: external stages and their child processes.
//!
//! - Input: the child processes of this process.
//! - Output: killed and reaped orphans.
//! - Time: the system clock, for the time limit at shutdown.
//! - Failure: without the kernel option `CONFIG_PROC_CHILDREN` orphans are not found. A stage then
//!   ends when its socket is closed.

use std::{
    collections::BTreeSet,
    fs, thread,
    time::{Duration, Instant},
};

use rustix::process::{
    Pid, Signal, WaitOptions, getpgid, getpid, kill_process, kill_process_group, set_child_subreaper, waitpid,
};

/// Interval between two searches while no service exits. The exit of a service's child process
/// causes no notification.
const SEARCH_INTERVAL: Duration = Duration::from_secs(1);
/// Time limit for the last orphans to exit at shutdown.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(500);
const SHUTDOWN_POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Descendants without a parent. The kernel makes them children of this process.
///
/// Dropping this value kills the orphans.
#[derive(Debug)]
pub(crate) struct Orphans {
    /// Child processes that are not orphans: services, and children that existed before the system.
    known: BTreeSet<u32>,
    last_search: Instant,
}

impl Default for Orphans {
    fn default() -> Self {
        // An error means that orphans become children of the init process and are not found here.
        let _ = set_child_subreaper(Some(getpid()));
        Self { known: children(), last_search: Instant::now() }
    }
}

impl Orphans {
    /// Marks a child process as a service.
    pub(crate) fn add_known(&mut self, pid: u32) {
        self.known.insert(pid);
    }

    /// Kills and reaps orphans if a service has exited or an interval has passed.
    pub(crate) fn poll(&mut self, has_exits: bool) {
        if has_exits || self.last_search.elapsed() >= SEARCH_INTERVAL {
            self.last_search = Instant::now();
            self.kill();
        }
    }

    /// Kills the orphans and their process groups, and reaps those that have exited. Returns the
    /// number of orphans found.
    fn kill(&mut self) -> usize {
        let children = children();
        // The kernel may leave a process out of the list while another one is being reaped.
        let exists = |pid: &u32| Pid::from_raw(*pid as i32).is_some_and(|pid| getpgid(Some(pid)).is_ok());
        self.known.retain(|pid| children.contains(pid) || exists(pid));
        let own_group = getpgid(None).ok();
        let is_foreign =
            |group: &Pid| Some(*group) != own_group && !self.known.contains(&(group.as_raw_nonzero().get() as u32));
        let orphans = children.difference(&self.known).filter_map(|pid| Pid::from_raw(*pid as i32));
        orphans
            .inspect(|pid| {
                // Errors mean that the process has exited.
                let group = getpgid(Some(*pid)).ok().filter(is_foreign);
                let _ = group.map(|group| kill_process_group(group, Signal::KILL));
                let _ = kill_process(*pid, Signal::KILL);
                let _ = waitpid(Some(*pid), WaitOptions::NOHANG);
            })
            .count()
    }
}

impl Drop for Orphans {
    /// Kills and reaps all orphans, within a time limit.
    ///
    /// Several rounds may be necessary, because the children of an orphan become orphans when it
    /// exits.
    fn drop(&mut self) {
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while self.kill() > 0 && Instant::now() < deadline {
            thread::sleep(SHUTDOWN_POLL_INTERVAL);
        }
    }
}

/// Returns the child processes of this process, including those that have exited but are not
/// reaped.
fn children() -> BTreeSet<u32> {
    let threads = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let lists = threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<u32>>()).collect()
}
