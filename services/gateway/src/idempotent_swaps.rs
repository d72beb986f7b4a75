//! Executes each swap request only once, and replies by its deadline.
//!
//! A repeated request gets the reply to the original request. A request that arrives after its
//! deadline or has an outdated epoch is rejected. The supervisor itself checks the epoch, so that
//! no other decision can be made between the check and the swap.

use std::{
    collections::VecDeque,
    fmt,
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread,
    time::Duration,
};

use control::SwapReport;
use launch::StageConfig;
use runtime::clock::monotonic_ns;
use wire::v1::{SwapAnswer, SwapRequest, swap_answer};

use crate::locked::locked;

/// Maximum number of remembered requests.
const MAX_REMEMBERED: usize = 256;
/// Maximum number of requests in progress.
const MAX_IN_PROGRESS: usize = 4;
/// Maximum time by which a deadline may lie in the future, ns.
const MAX_DEADLINE_AHEAD_NS: u64 = 60_000_000_000;

/// Margin before the deadline, ms. The supervisor stops waiting this long before the deadline, so
/// that the reply is in time.
const REPLY_MARGIN_MS: u64 = 500;

/// Function that forwards a request to the supervisor. The error is a text for display.
pub type SwapClient = Box<dyn Fn(control::SwapRequest) -> Result<SwapReport, String> + Send + Sync>;

/// Swap requests in progress, and recent requests with their replies.
pub struct IdempotentSwaps {
    client: SwapClient,
    state: Mutex<State>,
    replied: Condvar,
}

#[derive(Default)]
struct State {
    requests: VecDeque<RequestEntry>,
    forwarded: u64,
    answered_locally: u64,
}

struct RequestEntry {
    request: SwapRequest,
    reply: Option<SwapAnswer>,
}

impl IdempotentSwaps {
    /// Creates an empty set of requests. New requests are forwarded through `client`.
    pub fn new(client: SwapClient) -> Self {
        Self { client, state: Mutex::default(), replied: Condvar::new() }
    }

    /// Returns the number of requests forwarded to the supervisor and the number answered without
    /// it.
    pub fn counts(&self) -> [u64; 2] {
        let state = locked(&self.state);
        [state.forwarded, state.answered_locally]
    }

    /// Executes a request and returns the reply, no later than the deadline of the request.
    pub fn handle(self: &Arc<Self>, request: SwapRequest) -> SwapAnswer {
        match self.register(&request) {
            Ok(true) => {
                let (swaps, request) = (self.clone(), request.clone());
                thread::spawn(move || swaps.execute(request));
            }
            Ok(false) => {}
            Err(reason) => return rejected(&request, reason),
        }
        self.wait_for_reply(&request)
    }

    /// Registers a request. Returns `true` if it is new, `false` if it is a repetition.
    ///
    /// # Errors
    ///
    /// Returns the reason if the request is rejected.
    fn register(&self, request: &SwapRequest) -> Result<bool, String> {
        let mut state = locked(&self.state);
        state.answered_locally += 1;
        if let Some(entry) = state.requests.iter().find(|entry| entry.request.request_id == request.request_id) {
            return if is_repeat(&entry.request, request) {
                Ok(false)
            } else {
                Err(format!("request_id {:?} was used for another request; choose a new one", request.request_id))
            };
        }
        let now_ns = monotonic_ns();
        if request.t_deadline_ns <= now_ns {
            let late_ms = (now_ns - request.t_deadline_ns) / 1_000_000;
            return Err(format!(
                "request received {late_ms} ms after its deadline; query `services` and send a new request"
            ));
        }
        if request.t_deadline_ns - now_ns > MAX_DEADLINE_AHEAD_NS {
            return Err(
                "t_deadline_ns is more than a minute ahead; derive it from t_now_ns of `services`, the board's clock"
                    .into(),
            );
        }
        if state.requests.iter().filter(|entry| entry.reply.is_none()).count() >= MAX_IN_PROGRESS {
            return Err(format!("{MAX_IN_PROGRESS} requests are in progress already; wait for a reply"));
        }
        if state.requests.len() >= MAX_REMEMBERED
            && let Some(oldest) = state.requests.iter().position(|entry| entry.reply.is_some())
        {
            state.requests.remove(oldest);
        }
        state.requests.push_back(RequestEntry { request: request.clone(), reply: None });
        (state.forwarded, state.answered_locally) = (state.forwarded + 1, state.answered_locally - 1);
        Ok(true)
    }

    fn execute(&self, request: SwapRequest) {
        let reply = match (self.client)(to_supervisor(&request)) {
            Ok(report) => report.into_answer(request.request_id.clone()),
            Err(cause) => rejected(&request, cause),
        };
        let mut state = locked(&self.state);
        if let Some(entry) = state.requests.iter_mut().find(|entry| entry.request.request_id == request.request_id) {
            entry.reply = Some(reply);
        }
        self.replied.notify_all();
    }

    fn wait_for_reply(&self, request: &SwapRequest) -> SwapAnswer {
        let find = |state: &State| {
            let entry = state.requests.iter().find(|entry| entry.request.request_id == request.request_id)?;
            entry.reply.clone()
        };
        let timeout =
            Duration::from_nanos(request.t_deadline_ns.saturating_sub(monotonic_ns()).min(MAX_DEADLINE_AHEAD_NS));
        let waited = self.replied.wait_timeout_while(locked(&self.state), timeout, |state| find(state).is_none());
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        find(&state).unwrap_or_else(|| SwapAnswer {
            outcome: swap_answer::Outcome::Unknown.into(),
            reason: "the deadline passed before the swap ended; query `services`, or send the same request with a later deadline".into(),
            ..rejected(request, String::new())
        })
    }
}

impl fmt::Debug for IdempotentSwaps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("IdempotentSwaps").field(&self.counts()).finish()
    }
}

/// Returns `true` if the requests are equal apart from their deadlines.
fn is_repeat(first: &SwapRequest, second: &SwapRequest) -> bool {
    SwapRequest { t_deadline_ns: 0, ..first.clone() } == SwapRequest { t_deadline_ns: 0, ..second.clone() }
}

fn to_supervisor(request: &SwapRequest) -> control::SwapRequest {
    let SwapRequest { slot, stage, set, expected_epoch, .. } = request.clone();
    let remaining_ms = request.t_deadline_ns.saturating_sub(monotonic_ns()) / 1_000_000;
    let timeout_ms = Some(remaining_ms.saturating_sub(REPLY_MARGIN_MS));
    control::SwapRequest {
        slot,
        stage: StageConfig { stage, set },
        shadow: false,
        expected_epoch: Some(expected_epoch),
        timeout_ms,
    }
}

fn rejected(request: &SwapRequest, reason: String) -> SwapAnswer {
    SwapAnswer {
        request_id: request.request_id.clone(),
        outcome: swap_answer::Outcome::Refused.into(),
        reason,
        slot: request.slot.clone(),
        to: request.stage.clone(),
        ..SwapAnswer::default()
    }
}
