//! Interface for recorders of all published messages.
//!
//! - Input: the messages of every topic, from the first tick on.
//! - Output: defined by the recorder.
//! - Failure: a failed recorder reports its failure. The system keeps running.

use graph::Topic;
use runtime::ServiceConfig;

use crate::{
    error::UpError,
    report::{RecordingReport, Report},
};

/// Recorder of all published messages.
///
/// The methods must not block for long. In lockstep the source may wait for them.
pub trait Recorder {
    /// Starts the recording. Called before any service starts.
    ///
    /// # Errors
    ///
    /// Returns an error if the recording cannot be created.
    fn start(&mut self, config: &ServiceConfig) -> Result<(), UpError>;
    /// Records a message of a topic.
    fn record(&mut self, topic: Topic, message: &[u8]);
    /// Handles an overflow: the buffer of a topic was full before it was read, so messages may be
    /// missing.
    fn on_overflow(&mut self, topic: Topic);
    /// Ends a round of messages. Called several times per second.
    fn end_round(&mut self);
    /// Returns the reason why the recording has failed, or `None` if it has not failed.
    fn failure(&self) -> Option<String>;
    /// Finishes the recording with the report of the run.
    fn finish(&mut self, report: &Report) -> RecordingReport;
}
