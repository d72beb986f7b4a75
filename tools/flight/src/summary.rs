//! What came of a recording.

use std::{fmt, path::PathBuf};

use launch::pluralize;
use serde::Serialize;

use crate::FlightError;

/// What came of a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The file.
    pub file: PathBuf,
    /// From the first message to the last, s.
    pub seconds: f64,
    /// Bytes in the file.
    pub bytes: u64,
    /// Messages in the file that came over the bus.
    pub messages: u64,
    /// Messages, at least, that were published and are not in the file.
    pub missed: u64,
    /// Each topic that was recorded.
    pub topics: Vec<TopicSummary>,
    /// Why the file is not whole, or not there; `None` where it is.
    pub error: Option<String>,
}

/// What came of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TopicSummary {
    /// Its name.
    pub topic: &'static str,
    /// Messages in the file.
    pub messages: u64,
    /// Messages, at least, that were published and are not in it.
    pub missed: u64,
}

impl Summary {
    /// With what was missed, where nothing worse has happened.
    pub(crate) fn judged(mut self) -> Self {
        if self.error.is_none() && self.missed > 0 {
            let missed = FlightError::Missed { path: self.file.clone(), missed: self.missed };
            self.error = Some(missed.to_string());
        }
        self
    }
}

/// For people: the file on the first line, then the topics.
impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, seconds, bytes, messages, missed, topics, .. } = self;
        write!(
            f,
            "{}: {} in {seconds:.1} s, missed {missed}, {:.1} MB",
            file.display(),
            pluralize(*messages, "message"),
            *bytes as f64 * 1e-6
        )?;
        for TopicSummary { topic, messages, missed } in topics.iter().filter(|it| it.messages + it.missed > 0) {
            write!(f, "\n  {topic:<12}{:>19}, missed {missed}", pluralize(*messages, "message"))?;
        }
        Ok(())
    }
}
