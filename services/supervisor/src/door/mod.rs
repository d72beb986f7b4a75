//! The door of a running system: a socket at which other programs ask.
//!
//! Input: one line of JSON from each caller. Output: one line back; where the answer takes time, one before it that the question was
//! taken. Time: none is lost, as a caller who says nothing holds up nobody. Failure: what is no question is answered with what is
//! wrong with it; callers beyond the limit, and those who say nothing, are sent away.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `asking` | who asks |
//! | `listening` | who is asked |

mod asking;
mod listening;
#[cfg(test)]
mod tests;

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::exchange::Wish;

pub use asking::{DoorError, ask};
pub(crate) use listening::Door;

/// A question or an answer, bytes.
const LINE_MAX: usize = 64 * 1024;
/// A system that runs says something within this time.
const SILENCE_LIMIT: Duration = Duration::from_secs(2);
/// What a swap may take once ticks come: the deadlines of its stages, of those of the one before it, and as much again.
const SWAP_LIMIT: Duration = Duration::from_secs(30);

/// What may be asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ask {
    /// Exchange what fills a slot.
    Swap(Wish),
    /// End a shadow.
    Cancel {
        /// The slot.
        slot: String,
    },
    /// How the services are.
    Ps,
    /// What was to run, with the stages that fill the slots by now.
    Orders,
    /// What the report and the file lack by now.
    Record,
    /// A service has something to say to people.
    Tell {
        /// Which one.
        service: String,
        /// A line.
        what: String,
    },
    /// A service says where it can be reached.
    At {
        /// Which one.
        service: String,
        /// Its address.
        at: String,
    },
}

impl Ask {
    /// The question is taken first, and answered later.
    fn takes_time(&self) -> bool {
        matches!(self, Self::Swap(_))
    }

    /// How long the answer to a question that was taken is waited for. A shadow has no limit: it ends with whoever asked for it.
    fn answer_limit(&self) -> Option<Duration> {
        match self {
            Self::Swap(Wish { limit_ms, .. }) => Some(SWAP_LIMIT + Duration::from_millis((*limit_ms)?)),
            _ => Some(SILENCE_LIMIT),
        }
    }
}

/// A line to a caller.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Said<A> {
    /// The question is a question; its answer comes.
    Taken,
    Answer(A),
    Error(String),
}
