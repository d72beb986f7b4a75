//! Removes the leftovers of killed services from the bus, in parallel with the supervisor.
//!
//! - Input: notifications of exits.
//! - Output: freed ports and segments.
//! - Time: the system clock, for a delay that leaves the processor to the restarted service.
//! - Failure: a failed removal is retried. A separate thread is used, because iceoryx2 may wait
//!   forever for a segment whose creator was killed.

use std::{
    sync::mpsc::{self, RecvTimeoutError, SyncSender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use bus::SystemName;

use crate::error::UpError;

/// Delay between the exit of a service and the removal of its resources. It is long enough for the
/// service to have restarted.
const CLEANUP_DELAY: Duration = Duration::from_millis(50);
/// Interval between periodic removals. They are needed because the exit of some processes, such as
/// observers, causes no notification.
const CLEANUP_INTERVAL: Duration = Duration::from_secs(5);
/// Time limit for the thread to end at shutdown.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(200);

#[derive(Debug)]
pub(crate) struct StaleNodeReaper {
    exits: Option<SyncSender<()>>,
    thread: JoinHandle<()>,
}

impl StaleNodeReaper {
    pub(crate) fn new(system_name: SystemName) -> Result<Self, UpError> {
        let (exits, received) = mpsc::sync_channel(1);
        let work = move || {
            loop {
                match received.recv_timeout(CLEANUP_INTERVAL) {
                    Ok(()) => thread::sleep(CLEANUP_DELAY),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                // A failed removal is retried in the next round.
                let _ = system_name.remove_dead_nodes();
            }
        };
        let thread = thread::Builder::new()
            .name("reaper".into())
            .spawn(work)
            .map_err(|cause| UpError::System { action: "starting the reaper".into(), cause })?;
        Ok(Self { exits: Some(exits), thread })
    }

    /// Notifies the thread that a process has exited.
    pub(crate) fn notify_exit(&self) {
        if let Some(exits) = &self.exits {
            // A pending notification covers this exit as well.
            let _ = exits.try_send(());
        }
    }
}

impl Drop for StaleNodeReaper {
    fn drop(&mut self) {
        self.exits = None;
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while !self.thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    }
}
