//! Reports device problems to the supervisor and the user. A separate thread sends the reports, so
//! that the service never waits.

use std::{
    sync::mpsc::{self, SyncSender},
    thread,
};

use control::{ControlRequest, Diagnostic};
use launch::Service;

/// Maximum number of queued requests. Further ones are dropped.
const MAX_QUEUED: usize = 64;

pub(crate) struct DiagnosticsPublisher {
    requests: SyncSender<ControlRequest>,
    published: Vec<Diagnostic>,
}

impl DiagnosticsPublisher {
    pub(crate) fn start(system: String) -> std::io::Result<Self> {
        let (requests, queue) = mpsc::sync_channel::<ControlRequest>(MAX_QUEUED);
        thread::Builder::new().name("diagnostics".into()).spawn(move || {
            while let Ok(request) = queue.recv() {
                control::notify(&system, &request, || false);
            }
        })?;
        Ok(Self { requests, published: Vec::new() })
    }

    /// Publishes the current problems and announces their [`changes`].
    pub(crate) fn publish(&mut self, current: Vec<Diagnostic>) {
        if current == self.published {
            return;
        }
        let service = || Service::Drivers.name().to_owned();
        let lines = changes(&self.published, &current);
        let state = ControlRequest::Diagnostics { service: service(), diagnostics: current.clone() };
        // If the queue is full, the next call tries again.
        if self.requests.try_send(state).is_ok() {
            self.published = current;
            lines.into_iter().for_each(|line| {
                let _ = self.requests.try_send(ControlRequest::Announce { service: service(), line });
            });
        }
    }
}

/// Returns a line for each problem that has appeared or is resolved. A problem in which only
/// numbers have changed gets no line.
pub(crate) fn changes(previous: &[Diagnostic], current: &[Diagnostic]) -> Vec<String> {
    let is_in =
        |list: &[Diagnostic], diagnostic: &Diagnostic| list.iter().any(|other| is_same_problem(other, diagnostic));
    let resolved = previous.iter().filter(|old| !is_in(current, old)).map(|old| format!("resolved: {}", old.found));
    let new = current.iter().filter(|new| !is_in(previous, new));
    resolved.chain(new.map(|Diagnostic { found, remedy, .. }| format!("{found}; {remedy}"))).collect()
}

/// Returns `true` if both problems are of the same kind. For an unavailable port, the cause must be
/// the same, too.
fn is_same_problem(a: &Diagnostic, b: &Diagnostic) -> bool {
    a.kind == b.kind && (a.kind != crate::device_monitor::UNAVAILABLE || a.found == b.found)
}
