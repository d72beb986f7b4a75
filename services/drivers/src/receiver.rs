//! Satellite receiver that is read in addition to the source, in a separate thread.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, RecvTimeoutError, SyncSender, TrySendError},
    },
    thread,
    time::Duration,
};

use decoders::{Measurement, Value};
use launch::ReceiverSource;

use crate::{
    error::DriversError,
    format,
    input::{DeviceReport, Input, READ_TIMEOUT, ReadOutcome},
    port::StdinDescriptor,
    reconnecting_port::StreamOrigin,
    stream::DeviceStream,
};

/// Maximum number of queued fixes. Further ones are dropped, because they would be outdated when
/// consumed.
const MAX_QUEUED_FIXES: usize = 64;

/// Satellite receiver with the fixes and the latest report of its thread.
pub(crate) struct Receiver {
    fixes: mpsc::Receiver<Measurement>,
    report: Arc<Mutex<DeviceReport>>,
}

impl Receiver {
    /// Starts the thread, or returns `None` if no receiver is configured.
    pub(crate) fn start(source: &ReceiverSource) -> Result<Option<Self>, DriversError> {
        let Some(port) = source.port.clone() else { return Ok(None) };
        let format = source.format;
        let (fix_queue, fixes) = mpsc::sync_channel(MAX_QUEUED_FIXES);
        let report = Arc::<Mutex<DeviceReport>>::default();
        let shared_report = report.clone();
        thread::Builder::new().name("receiver".into()).spawn(move || {
            let make_decoder = Box::new(move || Ok(format::receiver_decoder(format)));
            let origin = StreamOrigin { is_resumed: true, stdin: StdinDescriptor::Passed };
            // Receiver formats have no settings, so opening their decoders cannot fail.
            DeviceStream::open(port, format.name(), origin, None, make_decoder)
                .into_iter()
                .for_each(|input| forward_fixes(input, &fix_queue, &shared_report));
        })?;
        Ok(Some(Self { fixes, report }))
    }

    /// Returns the next fix, or `None` if none arrives within `timeout`.
    pub(crate) fn next_fix(&self, timeout: Duration) -> Option<Measurement> {
        match self.fixes.recv_timeout(timeout) {
            Ok(fix) => Some(fix),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                thread::sleep(timeout);
                None
            }
        }
    }

    /// Returns the queued fixes. Their number is limited, because the thread may add fixes faster
    /// than they are read.
    pub(crate) fn queued_fixes(&self) -> impl Iterator<Item = Measurement> {
        self.fixes.try_iter().take(MAX_QUEUED_FIXES)
    }

    pub(crate) fn report(&self) -> DeviceReport {
        self.report.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Forwards fixes until the receiving end of the queue is dropped.
fn forward_fixes(mut input: DeviceStream, fix_queue: &SyncSender<Measurement>, report: &Mutex<DeviceReport>) {
    let mut measurements = Vec::new();
    loop {
        let Ok(step) = input.read(READ_TIMEOUT, &mut measurements) else { return };
        for measurement in measurements.drain(..).filter(|measurement| matches!(measurement.value, Value::Fix { .. })) {
            if let Err(TrySendError::Disconnected(_)) = fix_queue.try_send(measurement) {
                return;
            }
        }
        *report.lock().unwrap_or_else(PoisonError::into_inner) = input.report();
        if step == ReadOutcome::End {
            thread::sleep(READ_TIMEOUT);
        }
    }
}
