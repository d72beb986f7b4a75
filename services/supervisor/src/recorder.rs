//! Who takes down everything that is published, while it is published.
//!
//! Input: the messages of every topic, from the first tick on. Output: what the recorder makes of them. Time: none. Failure: a recorder that
//! can go on no more says so, and nothing else ends.

use std::path::PathBuf;

use graph::Topic;
use runtime::ServiceConfig;
use serde::Serialize;

use crate::{Report, UpError};

/// Who takes down everything that is published. It never waits for long, but that a source in lockstep may wait for it.
pub trait Recorder {
    /// The system is about to start.
    fn begin(&mut self, config: &ServiceConfig) -> Result<(), UpError>;
    /// A message of a topic.
    fn take(&mut self, topic: Topic, message: &[u8]);
    /// The buffer of a topic was full before it was read: messages may have been overwritten.
    fn overflowed(&mut self, topic: Topic);
    /// What there was has been taken; called several times a second.
    fn look(&mut self);
    /// Why nothing more is taken down, once it is so.
    fn failure(&self) -> Option<String>;
    /// The run is over.
    fn end(&mut self, report: &Report) -> RecordingReport;
}

/// What became of a recording.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RecordingReport {
    /// The file.
    pub file: PathBuf,
    /// Messages in it.
    pub messages: u64,
    /// Messages, at least, that were published and are not in it.
    pub missed: u64,
    /// Its length.
    pub bytes: u64,
    /// Why it is not whole; `None` where it is.
    pub error: Option<String>,
}
