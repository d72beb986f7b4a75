//! State of the vehicles that `plumb station` monitors.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use link::MessageStream;
use observe::tables::{CsvTables, TableError};

use super::fleet::{self, Vehicles};

/// Longest wait for a message.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(20);

/// Maximum number of messages received per poll, so that key input and display are not starved.
const MAX_MESSAGES: usize = 1000;

/// Received messages and the state of the vehicles.
pub(super) struct VehicleMonitor {
    pub(super) messages: MessageStream,
    pub(super) liveliness: MessageStream,
    pub(super) tables: Option<CsvTables>,
    pub(super) vehicles: Vehicles,
    pub(super) stop: Arc<AtomicBool>,
    pub(super) started: Instant,
    pub(super) seconds: Option<f64>,
}

impl VehicleMonitor {
    pub(super) fn is_finished(&self) -> bool {
        let is_timed_out = self.seconds.is_some_and(|limit_s| self.started.elapsed().as_secs_f64() > limit_s);
        is_timed_out || self.stop.load(Ordering::SeqCst)
    }

    /// Processes received messages. Waits briefly if no message is available.
    pub(super) fn poll(&mut self) -> Result<(), TableError> {
        while let Some(token) = self.liveliness.next(Duration::ZERO) {
            fleet::update_liveliness(&mut self.vehicles, &token);
        }
        let mut wait = RECEIVE_TIMEOUT;
        for _ in 0..MAX_MESSAGES {
            let Some(message) = self.messages.next(wait) else { break };
            wait = Duration::ZERO;
            fleet::record_message(&mut self.vehicles, &message, self.tables.as_mut())?;
        }
        Ok(())
    }
}
