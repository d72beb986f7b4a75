//! Clears away what killed services leave on the bus, beside everything else: a new incarnation neither waits for it nor does it.
//!
//! Input: that somebody has died. Output: ports and segments freed. Time: the clock, for a pause that leaves the machine to the next incarnation.
//! Failure: what cannot be removed is tried again; iceoryx2 may wait for ever for a segment whose maker was killed, so it is a thread of its own.

use std::{
    sync::mpsc::{self, RecvTimeoutError, SyncSender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use bus::SystemName;

use crate::UpError;

/// From a death until its remains are cleared away: the next incarnation has begun by then.
const PAUSE: Duration = Duration::from_millis(50);
/// At the latest after so long it looks by itself: an observer may have been killed.
const LOOK: Duration = Duration::from_secs(1);
/// How long the end waits for it.
const END_LIMIT: Duration = Duration::from_millis(200);

/// The thread.
#[derive(Debug)]
pub(crate) struct StaleNodeReaper {
    deaths: Option<SyncSender<()>>,
    thread: JoinHandle<()>,
}

impl StaleNodeReaper {
    pub(crate) fn new(system_name: SystemName) -> Result<Self, UpError> {
        let (deaths, heard) = mpsc::sync_channel(1);
        let work = move || {
            loop {
                match heard.recv_timeout(LOOK) {
                    Ok(()) => thread::sleep(PAUSE),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                // What is left is found again at the next look.
                let _ = system_name.clean();
            }
        };
        let thread = thread::Builder::new()
            .name("reaper".into())
            .spawn(work)
            .map_err(|cause| UpError::System { doing: "starting the reaper".into(), cause })?;
        Ok(Self { deaths: Some(deaths), thread })
    }

    /// Somebody has died.
    pub(crate) fn note_death(&self) {
        if let Some(deaths) = &self.deaths {
            // One that waits already stands for this one too.
            let _ = deaths.try_send(());
        }
    }
}

impl Drop for StaleNodeReaper {
    fn drop(&mut self) {
        self.deaths = None;
        let deadline = Instant::now() + END_LIMIT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }
}
