//! State of a swap.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{
    OwnershipStatus,
    event::{Progress, Request},
};

/// State of a swap in a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SwapState {
    /// No swap is in progress.
    Idle,
    /// The candidate is starting.
    Starting,
    /// The candidate is processing the history of its input.
    CatchingUp,
    /// The candidate computes in parallel with the active stage.
    Shadowing,
    /// The new stage is taking over from an owner that has exited. The first new tick that the
    /// stage publishes confirms the takeover.
    TakingOver,
    /// The hand-over has been decided.
    Armed {
        /// First tick of the candidate.
        from_tick: u64,
    },
    /// The candidate owns the slot. The previous stage still runs without publishing.
    Committed {
        /// Incarnation of the previous stage.
        previous: u32,
    },
    /// The previous stage is being stopped.
    Retiring {
        /// Incarnation of the previous stage.
        previous: u32,
    },
    /// The swap has failed: the candidate is being stopped and the active stage resumes ownership.
    Aborting,
}

impl fmt::Display for SwapState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idle => write!(f, "idle"),
            Self::Starting => write!(f, "starting the candidate"),
            Self::CatchingUp => write!(f, "candidate catching up"),
            Self::Shadowing => write!(f, "candidate running as a shadow"),
            Self::TakingOver => write!(f, "starting the new stage in place of the exited one"),
            Self::Armed { from_tick } => write!(f, "handing over at tick {from_tick}"),
            Self::Committed { previous } => {
                write!(f, "committed; the previous stage (incarnation {previous}) stays for restarting subscribers")
            }
            Self::Retiring { previous } => write!(f, "retiring the previous stage (incarnation {previous})"),
            Self::Aborting => write!(f, "returning the slot to the active stage"),
        }
    }
}

/// Swap in progress.
#[derive(Debug, Clone)]
pub(super) struct Swap {
    pub(super) request: Request,
    pub(super) state: SwapState,
    pub(super) started_ms: u64,
    pub(super) state_since_ms: u64,
    /// Time of the last stop request to the candidate.
    pub(super) stop_requested_ms: u64,
    /// `true` while the result of starting the candidate is pending.
    pub(super) spawn_pending: bool,
    pub(super) candidate: Option<u32>,
    pub(super) status: Option<OwnershipStatus>,
    /// Progress of the candidate.
    pub(super) progress: Progress,
    /// Number of ticks that a shadow had missed when it was promoted. The client has seen the
    /// resulting difference of the attitudes and accepts it.
    pub(super) accepted_missed_ticks: u64,
    /// Tick of the hand-over.
    pub(super) from_tick: Option<u64>,
    /// First tick not yet published when the owner exited; `None` while the owner is running.
    pub(super) takeover_tick: Option<u64>,
}

impl Swap {
    pub(super) fn new(request: Request, now_ms: u64) -> Self {
        Self {
            request,
            state: SwapState::Starting,
            started_ms: now_ms,
            state_since_ms: now_ms,
            stop_requested_ms: now_ms,
            spawn_pending: true,
            candidate: None,
            status: None,
            progress: Progress::default(),
            accepted_missed_ticks: 0,
            from_tick: None,
            takeover_tick: None,
        }
    }

    pub(super) fn enter(&mut self, state: SwapState, now_ms: u64) {
        (self.state, self.state_since_ms) = (state, now_ms);
    }

    /// Returns `true` before the swap is committed. Until then, the active stage can keep or resume
    /// ownership of the slot.
    pub(super) fn is_open(&self) -> bool {
        !matches!(self.state, SwapState::Committed { .. } | SwapState::Retiring { .. })
    }
}
