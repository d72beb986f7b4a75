//! Requests the statuses of the services in a separate thread.
//!
//! - Input: the control socket of the system.
//! - Output: the newest statuses.
//! - Time: a supervisor that answers slowly does not delay the attitudes.
//! - Failure: the error of the request is the result.

use std::{
    sync::mpsc::{Receiver, sync_channel},
    thread,
    time::Duration,
};

use control::{ControlError, ControlRequest, ServiceStatus, send_request};

/// Pause before each request. It limits the rate of requests. The next request is sent only after
/// the result of the previous one was read. Results that are read once per second are therefore at
/// most about one second old.
const REQUEST_PAUSE: Duration = Duration::from_millis(500);

type Statuses = Result<Vec<ServiceStatus>, ControlError>;

/// Requests statuses until it is dropped.
pub(super) struct StatusPoller(Receiver<Statuses>);

impl StatusPoller {
    /// Starts the thread. After the poller is dropped, the thread ends with its next result.
    pub(super) fn start(system: &str) -> Self {
        // The channel has no buffer, so the thread sends its next request only after this result
        // was read.
        let (results, receiver) = sync_channel(0);
        let system = system.to_owned();
        thread::spawn(move || {
            let mut is_read = true;
            while is_read {
                thread::sleep(REQUEST_PAUSE);
                is_read = results.send(send_request(&system, &ControlRequest::Status)).is_ok();
            }
        });
        Self(receiver)
    }

    /// Returns the newest result, or `None` if the supervisor has not answered since the last call.
    pub(super) fn newest(&self) -> Option<Statuses> {
        self.0.try_recv().ok()
    }
}
