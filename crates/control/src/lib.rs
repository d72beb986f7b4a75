//! The control socket of a running system, at which other programs ask.
//!
//! Input: one line of JSON from each caller. Output: one line back; where the answer takes time, one before it that the question was
//! taken. Time: none is lost, as a caller who says nothing holds up nobody. Failure: what is no question is answered with what is
//! wrong with it; callers beyond the limit, and those who say nothing, are sent away.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `client` | who asks |
//! | `server` | who is asked |

#![forbid(unsafe_code)]

mod client;
mod server;
#[cfg(test)]
mod tests;

use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use client::{ControlError, ask};
pub use server::ControlSocket;
pub use supervision::{ControlRequest, RecordStatus, ServiceStatus, SwapReport, SwapRequest, Trouble};
pub use swap::Outcome;

/// A request or an answer, bytes.
const LINE_MAX: usize = 64 * 1024;
/// A system that runs says something within this time.
const SILENCE_LIMIT: Duration = Duration::from_secs(2);
/// What a swap may take once ticks come: the deadlines of its stages, of those of the one before it, and as much again.
const SWAP_LIMIT: Duration = Duration::from_secs(30);

/// The request is taken first, and answered later.
fn takes_time(request: &ControlRequest) -> bool {
    matches!(request, ControlRequest::Swap(_))
}

/// How long the answer to a request that was taken is waited for. A shadow has no limit: it ends with whoever asked for it.
fn answer_limit(request: &ControlRequest) -> Option<Duration> {
    match request {
        ControlRequest::Swap(SwapRequest { limit_ms, .. }) => Some(SWAP_LIMIT + Duration::from_millis((*limit_ms)?)),
        _ => Some(SILENCE_LIMIT),
    }
}

/// A line to a caller.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Response<A> {
    /// The request is one; its answer comes.
    Taken,
    Answer(A),
    Error(String),
}
