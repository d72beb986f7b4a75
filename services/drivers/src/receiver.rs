//! A satellite receiver beside the source, read by a thread of its own.

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
    DriversError, WAIT, format,
    input::{Input, Report, Step},
    stream::Stream,
};

/// Fixes that wait; of more the newest are left out, which are as old as any by the time they are taken.
const FIXES_MAX: usize = 64;

/// The thread, and what it has found.
pub(crate) struct Receiver {
    fixes: mpsc::Receiver<Measurement>,
    report: Arc<Mutex<Report>>,
}

impl Receiver {
    /// None where no receiver is named.
    pub(crate) fn start(source: &ReceiverSource) -> Result<Option<Self>, DriversError> {
        let Some(port) = source.port.clone() else { return Ok(None) };
        let format = source.format;
        let (sender, fixes) = mpsc::sync_channel(FIXES_MAX);
        let report = Arc::<Mutex<Report>>::default();
        let shared = report.clone();
        thread::Builder::new().name("receiver".into()).spawn(move || {
            let make = Box::new(move || Ok(format::receiver(format)));
            // A decoder of a receiver has no settings that could be wrong.
            Stream::open(port, format.name(), true, None, make)
                .into_iter()
                .for_each(|input| read(input, &sender, &shared));
        })?;
        Ok(Some(Self { fixes, report }))
    }

    /// A fix that is there, or comes within the limit.
    pub(crate) fn take(&self, limit: Duration) -> Option<Measurement> {
        match self.fixes.recv_timeout(limit) {
            Ok(fix) => Some(fix),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                thread::sleep(limit);
                None
            }
        }
    }

    pub(crate) fn report(&self) -> Report {
        self.report.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Until nobody takes them.
fn read(mut input: Stream, fixes: &SyncSender<Measurement>, report: &Mutex<Report>) {
    let mut found = Vec::new();
    loop {
        let Ok(step) = input.take(WAIT, &mut found) else { return };
        for measurement in found.drain(..).filter(|one| matches!(one.value, Value::Fix { .. })) {
            if let Err(TrySendError::Disconnected(_)) = fixes.try_send(measurement) {
                return;
            }
        }
        *report.lock().unwrap_or_else(PoisonError::into_inner) = input.report();
        if step == Step::End {
            thread::sleep(WAIT);
        }
    }
}
