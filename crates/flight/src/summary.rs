//! Summary of a recorded file.

use std::{fmt, path::PathBuf};

use launch::pluralize;
use serde::Serialize;

use crate::FlightError;

/// Summary of a recorded file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingSummary {
    /// Path of the file.
    pub file: PathBuf,
    /// Time from the first message to the last, s.
    pub seconds: f64,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Number of bus messages in the file.
    pub messages: u64,
    /// Lower bound on the number of published messages that are missing from the file.
    pub missed: u64,
    /// Summaries of the recorded topics.
    pub topics: Vec<TopicSummary>,
    /// Error that made the file incomplete, if any.
    pub error: Option<String>,
}

/// Summary of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TopicSummary {
    /// Name of the topic.
    pub topic: &'static str,
    /// Number of messages in the file.
    pub messages: u64,
    /// Lower bound on the number of published messages that are missing from the file.
    pub missed: u64,
}

impl RecordingSummary {
    /// Sets the error to a report of the missed messages, if any, unless there is another error.
    pub(crate) fn with_missed_error(mut self) -> Self {
        if self.error.is_none() && self.missed > 0 {
            let missed = FlightError::MissedMessages { path: self.file.clone(), missed: self.missed };
            self.error = Some(missed.to_string());
        }
        self
    }
}

/// Shows the file on the first line, then the topics.
impl fmt::Display for RecordingSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, seconds, bytes, messages, missed, topics, .. } = self;
        write!(
            f,
            "{}: {} in {seconds:.1} s, missed {missed}, {:.1} MB",
            foreign::path(file),
            pluralize(*messages, "message"),
            *bytes as f64 * 1e-6
        )?;
        for TopicSummary { topic, messages, missed } in topics.iter().filter(|topic| topic.messages + topic.missed > 0)
        {
            write!(f, "\n  {topic:<12}{:>19}, missed {missed}", pluralize(*messages, "message"))?;
        }
        Ok(())
    }
}
