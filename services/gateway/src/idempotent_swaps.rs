//! Requests for a swap: each is carried out once, and answered by its deadline.
//!
//! A request that comes again is answered as the first was. One that comes after its deadline, or under a decision that is no longer the
//! last, is refused. The supervisor compares the decision itself, so nothing can come between.

use std::{
    collections::VecDeque,
    fmt,
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread,
    time::Duration,
};

use control::{Outcome, SwapReport};
use launch::Stage;
use runtime::clock::monotonic_ns;
use wire::v1::{SwapAnswer, SwapRequest, swap_answer};

use crate::locked;

/// Requests that are remembered.
const REMEMBERED_MAX: usize = 256;
/// Requests under way at once.
const UNDER_WAY_MAX: usize = 4;
/// A deadline may be so far ahead, ns.
const AHEAD_MAX_NS: u64 = 60_000_000_000;

/// So long before the deadline no tick is waited for any more, so that this can be answered, ms.
const ANSWER_MS: u64 = 500;

/// How the supervisor is asked; the error is for people.
pub type Asking = Box<dyn Fn(control::SwapRequest) -> Result<SwapReport, String> + Send + Sync>;

/// Where requests come in.
pub struct IdempotentSwaps {
    asking: Asking,
    state: Mutex<State>,
    answered: Condvar,
}

#[derive(Default)]
struct State {
    remembered: VecDeque<Remembered>,
    asked: u64,
    answered_here: u64,
}

struct Remembered {
    request: SwapRequest,
    answer: Option<SwapAnswer>,
}

impl IdempotentSwaps {
    /// Swaps that are passed on.
    pub fn new(asking: Asking) -> Self {
        Self { asking, state: Mutex::default(), answered: Condvar::new() }
    }

    /// Requests passed on, and those answered without.
    pub fn counts(&self) -> [u64; 2] {
        let state = locked(&self.state);
        [state.asked, state.answered_here]
    }

    /// Answers a request; waits no longer than its deadline.
    pub fn answer(self: &Arc<Self>, request: SwapRequest) -> SwapAnswer {
        match self.take(&request) {
            Ok(true) => {
                let (swaps, request) = (self.clone(), request.clone());
                thread::spawn(move || swaps.carry_out(request));
            }
            Ok(false) => {}
            Err(reason) => return refused(&request, reason),
        }
        self.wait(&request)
    }

    /// Remembers a new request: `true`. One that is known is not new; one that cannot be taken is refused with the reason.
    fn take(&self, request: &SwapRequest) -> Result<bool, String> {
        let mut state = locked(&self.state);
        state.answered_here += 1;
        if let Some(known) = state.remembered.iter().find(|known| known.request.request_id == request.request_id) {
            return if is_same(&known.request, request) {
                Ok(false)
            } else {
                Err(format!("the id {:?} was that of another request; choose a new one", request.request_id))
            };
        }
        let now_ns = monotonic_ns();
        if request.t_deadline_ns <= now_ns {
            let late_ms = (now_ns - request.t_deadline_ns) / 1_000_000;
            return Err(format!("it came {late_ms} ms after its deadline; ask for `services`, and again"));
        }
        if request.t_deadline_ns - now_ns > AHEAD_MAX_NS {
            return Err(
                "its deadline is more than a minute ahead; it counts on the board's clock, t_now_ns of `services`"
                    .into(),
            );
        }
        if state.remembered.iter().filter(|known| known.answer.is_none()).count() >= UNDER_WAY_MAX {
            return Err("too many requests are under way; wait for an answer".into());
        }
        if state.remembered.len() >= REMEMBERED_MAX
            && let Some(oldest) = state.remembered.iter().position(|known| known.answer.is_some())
        {
            state.remembered.remove(oldest);
        }
        state.remembered.push_back(Remembered { request: request.clone(), answer: None });
        (state.asked, state.answered_here) = (state.asked + 1, state.answered_here - 1);
        Ok(true)
    }

    fn carry_out(&self, request: SwapRequest) {
        let answer = match (self.asking)(wish(&request)) {
            Ok(report) => answer(&request, report),
            Err(cause) => refused(&request, cause),
        };
        let mut state = locked(&self.state);
        if let Some(known) = state.remembered.iter_mut().find(|known| known.request.request_id == request.request_id) {
            known.answer = Some(answer);
        }
        self.answered.notify_all();
    }

    fn wait(&self, request: &SwapRequest) -> SwapAnswer {
        let find = |state: &State| {
            let known = state.remembered.iter().find(|known| known.request.request_id == request.request_id)?;
            known.answer.clone()
        };
        let limit = Duration::from_nanos(request.t_deadline_ns.saturating_sub(monotonic_ns()).min(AHEAD_MAX_NS));
        let waited = self.answered.wait_timeout_while(locked(&self.state), limit, |state| find(state).is_none());
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        find(&state).unwrap_or_else(|| SwapAnswer {
            outcome: swap_answer::Outcome::Unknown.into(),
            reason: "the deadline passed first; ask for `services`, or the same again with a later deadline".into(),
            ..refused(request, String::new())
        })
    }
}

impl fmt::Debug for IdempotentSwaps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("IdempotentSwaps").field(&self.counts()).finish()
    }
}

/// The same but for how long one is willing to wait.
fn is_same(one: &SwapRequest, other: &SwapRequest) -> bool {
    SwapRequest { t_deadline_ns: 0, ..one.clone() } == SwapRequest { t_deadline_ns: 0, ..other.clone() }
}

fn wish(request: &SwapRequest) -> control::SwapRequest {
    let SwapRequest { slot, stage, set, expected_epoch, .. } = request.clone();
    let left_ms = request.t_deadline_ns.saturating_sub(monotonic_ns()) / 1_000_000;
    let limit_ms = Some(left_ms.saturating_sub(ANSWER_MS));
    control::SwapRequest {
        slot,
        stage: Stage { stage, set },
        shadow: false,
        expected_epoch: Some(expected_epoch),
        limit_ms,
    }
}

fn answer(request: &SwapRequest, report: SwapReport) -> SwapAnswer {
    let SwapReport { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = report;
    let outcome = match outcome {
        Outcome::Committed => swap_answer::Outcome::Committed,
        Outcome::Refused => swap_answer::Outcome::Refused,
        Outcome::Aborted => swap_answer::Outcome::Aborted,
    };
    SwapAnswer {
        request_id: request.request_id.clone(),
        outcome: outcome.into(),
        reason: reason.unwrap_or_default(),
        slot,
        from,
        to,
        commit_tick,
        lost,
        duplicated,
        gap_s: gap_us * 1e-6,
        jump_rad: jump_deg.to_radians(),
    }
}

fn refused(request: &SwapRequest, reason: String) -> SwapAnswer {
    SwapAnswer {
        request_id: request.request_id.clone(),
        outcome: swap_answer::Outcome::Refused.into(),
        reason,
        slot: request.slot.clone(),
        to: request.stage.clone(),
        ..SwapAnswer::default()
    }
}
