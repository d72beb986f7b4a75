//! The control socket of a running system, through which other programs send requests.
//!
//! Input: one line of JSON from each client.
//!
//! Output: one line of JSON per request. A request that takes time is first acknowledged with a
//! separate line.
//!
//! Time: a silent client does not delay other clients and is disconnected after a timeout.
//!
//! Failure: an invalid request receives an error as its response. If the maximum number of clients
//! is connected, further clients receive an error and are disconnected.
//!
//! | module | contents |
//! | --- | --- |
//! | `client` | the client side |
//! | `request` | requests and their replies |
//! | `server` | the supervisor's side |
//! | `proto` | conversion of replies to and from network messages, with the feature `wire` |

#![forbid(unsafe_code)]

mod client;
#[cfg(feature = "wire")]
mod proto;
mod request;
mod server;
#[cfg(test)]
mod tests;

use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use client::{ControlError, notify, send_request};
pub use request::{ControlRequest, Diagnostic, RecordStatus, ServiceStatus, SwapReport, SwapRequest};
pub use server::ControlSocket;
pub use swap::SwapOutcome;

/// Maximum length of a request or response, bytes.
const MAX_LINE_BYTES: usize = 64 * 1024;
/// Time within which a running system must send a line.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(2);
/// Time allowed for a swap after the slot has produced its first tick. It covers all deadlines of
/// this swap and of a preceding one.
const SWAP_TIMEOUT: Duration = Duration::from_secs(30);

/// Returns `true` if the request is acknowledged first and completed later.
fn is_long_running(request: &ControlRequest) -> bool {
    matches!(request, ControlRequest::Swap(_))
}

/// Returns the timeout for the completion of an acknowledged request. A shadow has no timeout,
/// because it ends when its client disconnects.
fn completion_timeout(request: &ControlRequest) -> Option<Duration> {
    match request {
        ControlRequest::Swap(SwapRequest { timeout_ms: limit_ms, .. }) => {
            Some(SWAP_TIMEOUT + Duration::from_millis((*limit_ms)?))
        }
        _ => Some(RESPONSE_TIMEOUT),
    }
}

/// Line sent to a client.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Response<A> {
    /// The request is valid, and its result will follow.
    Accepted,
    Completed(A),
    Error(String),
}
