//! A process's part in a system, given back when the last port of it is gone.

use std::{
    fs::{self, File},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crate::{BusError, SystemName, page::Page};

/// How long whoever clears away after a dead owner waits for the others: one that hangs is ended after a second.
const OTHERS_LIMIT: Duration = Duration::from_secs(2);

/// The page of wake words, and the lock that says that somebody takes part.
#[derive(Debug)]
pub(crate) struct Membership {
    pub(crate) page: Arc<Page>,
    run: u64,
    member: Option<File>,
    system_name: SystemName,
    /// The owner of the name when this process joined.
    owner_pid: u32,
    /// This process has been told that the owner has died.
    pub(crate) owner_has_died: Arc<AtomicBool>,
}

impl Membership {
    pub(crate) fn take(system_name: &SystemName) -> Result<Self, BusError> {
        let page = system_name.page()?;
        Ok(Self {
            run: page.run(),
            owner_pid: page.owner_pid(),
            owner_has_died: Arc::default(),
            page: Arc::new(page),
            member: Some(system_name.take_part()?),
            system_name: system_name.clone(),
        })
    }

    pub(crate) fn is_of_this_run(&self) -> bool {
        self.system_name.page().is_ok_and(|page| page.run() == self.run)
    }

    fn is_orphaned(&self) -> bool {
        self.owner_has_died.load(Ordering::SeqCst) || {
            let stat = fs::read_to_string(format!("/proc/{}/stat", self.owner_pid)).unwrap_or_default();
            // The state follows the name, which may hold anything.
            let state = stat.rsplit_once(')').and_then(|(_, after)| after.trim_start().chars().next());
            self.owner_pid != 0 && matches!(state, None | Some('Z'))
        }
    }
}

impl Drop for Membership {
    /// When the owner was killed, the services that it leaves behind remove what is left of the system.
    fn drop(&mut self) {
        self.member = None;
        if self.is_orphaned() {
            // Where another service does it, or somebody starts anew, there is nothing to do.
            drop(self.system_name.claim_left(OTHERS_LIMIT));
        }
    }
}
