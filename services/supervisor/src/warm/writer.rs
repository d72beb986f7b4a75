//! Thread that writes the state file, so that a slow, full or removed disk never blocks the
//! supervisor.

use std::{
    path::PathBuf,
    sync::mpsc::{self, Receiver, SyncSender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use runtime::Prior;

use super::{clock::Timestamp, file, record};
use crate::error::UpError;

/// Time limit for writing the last state at shutdown.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);
/// Maximum number of messages that wait to be read. Further messages are dropped.
const MAX_MESSAGES: usize = 4;

/// Thread that writes the state file.
#[derive(Debug)]
pub(super) struct StateWriter {
    states: SyncSender<(Prior, Instant)>,
    messages: Receiver<String>,
    thread: JoinHandle<()>,
}

impl StateWriter {
    pub(super) fn new(path: PathBuf, sensors: u64) -> Result<Self, UpError> {
        let (states, received) = mpsc::sync_channel::<(Prior, Instant)>(1);
        let (report, messages) = mpsc::sync_channel(MAX_MESSAGES);
        let work = move || {
            let mut last_error = None;
            for (prior, at) in received {
                let prior = prior.aged(at.elapsed().as_secs_f64(), false);
                let text = record::encode(prior, sensors, Timestamp::now()).map_err(Into::into);
                let written = text.and_then(|text| file::write(&path, &text)).map_err(|error| error.to_string());
                let name = foreign::path(&path);
                let line = match (&last_error, written.as_ref().err()) {
                    (before, Some(now)) if before.as_ref() != Some(now) => {
                        format!(
                            "state file {name}: cannot write it: {now}; retrying, but the next start may be a cold start"
                        )
                    }
                    (Some(_), None) => format!("state file {name}: writing works again"),
                    _ => continue,
                };
                last_error = written.err();
                // If the queue is full, this message is dropped, because an earlier one is still
                // waiting.
                let _ = report.try_send(line);
            }
        };
        let thread = thread::Builder::new().name("keeper".into()).spawn(work).map_err(|cause| UpError::System {
            action: "starting the thread that writes the state file".into(),
            cause,
        })?;
        Ok(Self { states, messages, thread })
    }

    /// Submits a state to be written. The state is dropped if an earlier one is still waiting,
    /// because that one is almost as recent.
    pub(super) fn submit(&self, prior: Prior) {
        let _ = self.states.try_send((prior, Instant::now()));
    }

    /// Returns the messages about the file since the previous call.
    pub(super) fn messages(&self) -> impl Iterator<Item = String> {
        self.messages.try_iter()
    }

    /// Waits until the last state is written, within a time limit, and returns the remaining
    /// messages.
    pub(super) fn finish(self) -> Vec<String> {
        let Self { states, messages, thread } = self;
        drop(states);
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while !thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        messages.try_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn write_failure_and_recovery_are_reported_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("folder/imu.state");
        // A file in place of the folder makes the write fail.
        fs::write(folder.path().join("folder"), "").unwrap();
        let writer = StateWriter::new(path.clone(), 1).unwrap();
        let submit = || {
            writer
                .states
                .send((Prior { bias_rad_s: None, hard_iron_ut: None, gyro_scale: None }, Instant::now()))
                .unwrap()
        };
        (0..3).for_each(|_| submit());
        assert!(writer.messages.recv().unwrap().contains("cannot write it: "));
        // The second of these two states is accepted only after the three states above have been
        // processed.
        (0..2).for_each(|_| submit());
        fs::remove_file(folder.path().join("folder")).unwrap();
        (0..2).for_each(|_| submit());
        let messages = writer.finish();
        assert_eq!(messages, [format!("state file {}: writing works again", path.display())]);
        assert!(fs::read_to_string(&path).unwrap().starts_with("plumbline state 2 "));
    }
}
