//! Topic of a running system that may be opened later.

use std::time::{Duration, Instant};

use bus::{BusError, Observer, Tap};
use graph::Topic;

/// Interval between two attempts to open a topic.
const OPEN_INTERVAL: Duration = Duration::from_millis(200);

/// Topic of a system on this machine that may become available later.
#[derive(Debug)]
pub struct LateTopic {
    topic: Topic,
    tap: Option<Tap>,
    tried_at: Option<Instant>,
}

impl LateTopic {
    /// Creates the topic, which is not open yet.
    pub fn new(topic: Topic) -> Self {
        Self { topic, tap: None, tried_at: None }
    }

    /// Returns the open topic. Tries to open it if an attempt is due.
    ///
    /// # Errors
    ///
    /// Returns an error if the topic is available but cannot be opened.
    pub fn tap(&mut self, observer: &Observer) -> Result<Option<&Tap>, BusError> {
        if self.tap.is_none() && self.tried_at.is_none_or(|tried_at| tried_at.elapsed() >= OPEN_INTERVAL) {
            self.tried_at = Some(Instant::now());
            self.tap = match observer.tap(self.topic) {
                Ok(tap) => Some(tap),
                Err(BusError::TopicNotOpen { .. }) => None,
                Err(error) => return Err(error),
            };
        }
        Ok(self.tap.as_ref())
    }
}
