//! A process's lease on a running system, released when the last port of the process is dropped.

use std::{
    fs::{self, File},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crate::{BusError, SystemName, shared_state::SharedState};

/// Timeout for other services to exit before leftovers of a killed owner are removed. A hanging
/// service is killed after one second, so it has exited by then.
const MEMBERS_EXIT_TIMEOUT: Duration = Duration::from_secs(2);

/// Shared state of the system, and the lock that marks this process as a member.
#[derive(Debug)]
pub(crate) struct ProcessLease {
    pub(crate) state: Arc<SharedState>,
    run: u64,
    members_lock: Option<File>,
    system_name: SystemName,
    /// Process ID of the owner at the time when this process joined.
    owner_pid: u32,
    /// Set when this process is notified that the owner has exited.
    pub(crate) owner_exited: Arc<AtomicBool>,
}

impl ProcessLease {
    pub(crate) fn acquire(system_name: &SystemName) -> Result<Self, BusError> {
        let state = system_name.shared_state()?;
        Ok(Self {
            run: state.run(),
            owner_pid: state.owner_pid(),
            owner_exited: Arc::default(),
            state: Arc::new(state),
            members_lock: Some(system_name.lock_members()?),
            system_name: system_name.clone(),
        })
    }

    pub(crate) fn is_current_run(&self) -> bool {
        self.system_name.shared_state().is_ok_and(|state| state.run() == self.run)
    }

    fn is_orphaned(&self) -> bool {
        self.owner_exited.load(Ordering::SeqCst) || {
            let stat = fs::read_to_string(format!("/proc/{}/stat", self.owner_pid)).unwrap_or_default();
            // In `/proc/PID/stat` the process state follows the process name, which is in
            // parentheses and may contain any character.
            let state = stat.rsplit_once(')').and_then(|(_, after)| after.trim_start().chars().next());
            self.owner_pid != 0 && matches!(state, None | Some('Z'))
        }
    }
}

impl Drop for ProcessLease {
    /// Leaves the system. If the owner was killed, the last service to leave removes the system's
    /// files.
    fn drop(&mut self) {
        self.members_lock = None;
        if self.is_orphaned() {
            // An error means that another process is already removing the files or has claimed the
            // name.
            drop(self.system_name.claim_orphaned(MEMBERS_EXIT_TIMEOUT));
        }
    }
}
