//! A process's part in a system, given back when the last port of it is gone.

use std::{
    fs::{self, File},
    sync::Arc,
    time::Duration,
};

use rustix::process::{Pid, getppid};

use crate::{BusError, SystemName, page::Page, system_name::LOOK};

/// How long whoever clears away after a dead owner waits for the others: one that hangs is ended after a second.
const OTHERS_LIMIT: Duration = Duration::from_secs(2);
/// Looks at whether the owner is dying: a service hears of its death a moment before that shows.
const LOOKS: u32 = 3;

/// The page of wake words, and the lock that says that somebody takes part.
#[derive(Debug)]
pub(crate) struct Membership {
    pub(crate) page: Arc<Page>,
    run: u64,
    member: Option<File>,
    system_name: SystemName,
    /// Who started this process: of a service, the owner of the name.
    parent: Option<Pid>,
}

impl Membership {
    pub(crate) fn take(system_name: &SystemName) -> Result<Self, BusError> {
        let page = system_name.page()?;
        Ok(Self {
            run: page.run(),
            page: Arc::new(page),
            member: Some(system_name.take_part()?),
            system_name: system_name.clone(),
            parent: getppid(),
        })
    }

    pub(crate) fn is_of_this_run(&self) -> bool {
        self.system_name.page().is_ok_and(|page| page.run() == self.run)
    }

    /// Whoever started this process has died, or is dying: its threads do not end at once.
    fn is_orphaned(&self) -> bool {
        let state = |pid: Pid| {
            let stat = fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).ok()?;
            stat.rsplit_once(')')?.1.trim_start().chars().next()
        };
        (0..LOOKS).any(|look| {
            std::thread::sleep(LOOK * look.min(1));
            getppid() != self.parent || self.parent.and_then(state) == Some('Z')
        })
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
