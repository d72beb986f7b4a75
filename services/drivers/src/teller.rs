//! What people and the supervisor are told, by a thread that waits for the supervisor.

use std::{
    sync::mpsc::{self, SyncSender},
    thread,
    time::{Duration, Instant},
};

use control::{ControlRequest, Trouble};
use launch::Service;

/// Told things that wait at most; of more the newest are left out.
const WAITING_MAX: usize = 64;
/// How long the supervisor is sought for, to be told something, and how often.
const LIMIT: Duration = Duration::from_secs(5);
const PAUSE: Duration = Duration::from_millis(100);

pub(crate) struct Teller {
    requests: SyncSender<ControlRequest>,
    told: Vec<Trouble>,
}

impl Teller {
    pub(crate) fn start(system: String) -> std::io::Result<Self> {
        let (requests, waiting) = mpsc::sync_channel::<ControlRequest>(WAITING_MAX);
        thread::Builder::new().name("teller".into()).spawn(move || {
            while let Ok(request) = waiting.recv() {
                let deadline = Instant::now() + LIMIT;
                while control::ask::<()>(&system, &request).is_err() && Instant::now() < deadline {
                    thread::sleep(PAUSE);
                }
            }
        })?;
        Ok(Self { requests, told: Vec::new() })
    }

    /// Takes all that is wrong by now. People are told of each kind when it comes and when it has gone, not when its figures change.
    pub(crate) fn troubles(&mut self, troubles: Vec<Trouble>) {
        if troubles == self.told {
            return;
        }
        let service = || Service::Drivers.name().to_owned();
        let is_in = |list: &[Trouble], trouble: &Trouble| list.iter().any(|other| is_same(other, trouble));
        let mut lines = Vec::new();
        lines.extend(
            self.told.iter().filter(|gone| !is_in(&troubles, gone)).map(|gone| format!("no more: {}", gone.found)),
        );
        let new = troubles.iter().filter(|new| !is_in(&self.told, new));
        lines.extend(new.map(|Trouble { found, remedy, .. }| format!("{found}; {remedy}")));
        let state = ControlRequest::Troubles { service: service(), troubles: troubles.clone() };
        // What does not go out now is tried again with the next look.
        if self.requests.try_send(state).is_ok() {
            self.told = troubles;
            lines.into_iter().for_each(|what| {
                let _ = self.requests.try_send(ControlRequest::Tell { service: service(), what });
            });
        }
    }
}

/// A port that is away for another reason is told of again.
fn is_same(a: &Trouble, b: &Trouble) -> bool {
    a.kind == b.kind && (a.kind != crate::troubles::AWAY || a.found == b.found)
}
