//! Where a swap is, and what is remembered of it.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{OwnershipStatus, event::Request};

/// Where the swap of a slot is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// No swap is under way.
    Idle,
    /// The candidate starts.
    Starting,
    /// The candidate works through the history of its input.
    CatchingUp,
    /// The candidate computes beside the active stage.
    Shadowing,
    /// The owner has ended: the new stage begins in its place, which is confirmed once it has published what nobody had.
    TakingOver,
    /// The change of hands is decided.
    Armed {
        /// The first tick of the candidate.
        from_tick: u64,
    },
    /// The candidate has the slot; the old stage is silent and still there.
    Committed {
        /// The old stage's incarnation.
        old: u32,
    },
    /// The old stage is being ended.
    Retiring {
        /// Its incarnation.
        old: u32,
    },
    /// The swap has failed: the candidate is being ended, the active stage takes its slot back.
    Aborting,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idle => write!(f, "idle"),
            Self::Starting => write!(f, "starting the candidate"),
            Self::CatchingUp => write!(f, "the candidate catches up"),
            Self::Shadowing => write!(f, "the candidate computes in the shadow"),
            Self::TakingOver => write!(f, "the new stage begins in the place of the one that has ended"),
            Self::Armed { from_tick } => write!(f, "changing hands at tick {from_tick}"),
            Self::Committed { old } => {
                write!(f, "committed; the old stage (incarnation {old}) stays for readers that restart")
            }
            Self::Retiring { old } => write!(f, "retiring the old stage (incarnation {old})"),
            Self::Aborting => write!(f, "giving the slot back"),
        }
    }
}

/// A swap under way.
#[derive(Debug, Clone)]
pub(super) struct Swap {
    pub(super) request: Request,
    pub(super) state: State,
    pub(super) began_ms: u64,
    pub(super) since_ms: u64,
    /// When the end of a service was asked for.
    pub(super) asked_ms: u64,
    /// The candidate's start has not been answered.
    pub(super) spawning: bool,
    pub(super) candidate: Option<u32>,
    pub(super) status: Option<OwnershipStatus>,
    /// The tick at which the slot was to change hands.
    pub(super) from_tick: Option<u64>,
    /// The owner has ended: before this tick everything had been published.
    pub(super) replaces: Option<u64>,
}

impl Swap {
    pub(super) fn new(request: Request, now_ms: u64) -> Self {
        Self {
            request,
            state: State::Starting,
            began_ms: now_ms,
            since_ms: now_ms,
            asked_ms: now_ms,
            spawning: true,
            candidate: None,
            status: None,
            from_tick: None,
            replaces: None,
        }
    }

    pub(super) fn enter(&mut self, state: State, now_ms: u64) {
        (self.state, self.since_ms) = (state, now_ms);
    }

    /// The slot may still go, or have to be given back, to the active stage.
    pub(super) fn is_open(&self) -> bool {
        !matches!(self.state, State::Committed { .. } | State::Retiring { .. })
    }
}
