//! Whether the files of the running system are still there, which somebody may remove: logind does when a user logs out (RemoveIPC).
//!
//! Input: that a service has ended. Output: whether its next life can join the others. Time: the clock, for looks in between. Failure: who
//! runs is not disturbed by it, and goes on for as long as everybody lives; then all start anew.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use bus::Domain;

use crate::{
    UpError,
    crew::{Crew, News},
};

/// Between two looks while nobody ends.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);

pub(crate) struct Damage {
    domain: Domain,
    looked: Instant,
    /// People have been told.
    told: bool,
}

impl Damage {
    pub(crate) fn new(domain: Domain) -> Self {
        Self { domain, looked: Instant::now(), told: false }
    }

    /// Looks now and then; what people are to be told, once.
    pub(crate) fn look(&mut self) -> Option<String> {
        if self.told || self.looked.elapsed() < LOOK_INTERVAL {
            return None;
        }
        self.looked = Instant::now();
        let path = self.removed(Vec::new())?;
        self.told = true;
        Some(format!(
            "somebody removes files of this system while it runs ({}); who runs goes on, and once a service ends all start anew. Is it logind, when \
             its user logs out? RemoveIPC=no in /etc/systemd/logind.conf, or let a system user run it",
            path.display()
        ))
    }

    /// Somebody has ended: fails where a next life could not join the others.
    pub(crate) fn assess(&self, crew: &Crew, news: &mut News) -> Result<(), UpError> {
        if !crew.lacks_somebody() {
            return Ok(());
        }
        let Some(path) = self.removed(crew.pids()) else { return Ok(()) };
        let damaged = UpError::Damaged { path };
        news.lines.push(format!("{damaged}: every service starts anew from its checkpoint"));
        Err(damaged)
    }

    /// A file that the supervisor or one of these processes has open and somebody has removed.
    fn removed(&self, mut pids: Vec<u32>) -> Option<PathBuf> {
        pids.push(std::process::id());
        self.domain.removed(&pids)
    }
}
