//! What the coordinator hears, what it asks for, and how a swap went.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{Control, OwnershipStatus};

/// Deadlines and distances of a swap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Time for the candidate to start and open its topics, ms.
    pub ready_ms: u64,
    /// Time for the candidate to catch up with the active stage, ms.
    pub caught_up_ms: u64,
    /// Time that the candidate computes beside the active stage before it takes over, ms.
    pub shadow_ms: u64,
    /// Time from the decision to the report of the first tick published under it, ms.
    pub commit_ms: u64,
    /// Time for the active stage to take the slot back after a swap that failed; then it is restarted, ms.
    pub restore_ms: u64,
    /// Longest time that the old stage stays, silent, after the commitment, for readers that restart, ms.
    pub linger_ms: u64,
    /// Time after which the end of a service that has not ended is asked for again, ms.
    pub end_ms: u64,
    /// Ticks that the candidate may be behind the active stage, and that behind its input, when hands change.
    pub lag_max_ticks: u64,
    /// Ticks between the newest one known and the first one of the new owner: what passes while a decision is on its way. Each further
    /// attempt has twice as many.
    pub margin_ticks: u64,
}

/// A swap that somebody asks for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// The number under which it is answered.
    pub id: u64,
    /// The stage that is to fill the slot.
    pub stage: String,
    /// The candidate computes beside the active stage until it is promoted or cancelled.
    pub shadow_only: bool,
    /// Until when it waits for a tick of the slot, ms; `u64::MAX` for a shadow.
    pub until_ms: u64,
    /// How often the slot was to change hands for it before, and the decision came too late.
    pub attempts_before: u32,
}

impl Limits {
    /// The margin of an attempt, ticks.
    pub fn margin_ticks(&self, attempts_before: u32) -> u64 {
        self.margin_ticks.saturating_mul(1 << attempts_before.min(16))
    }
}

/// What the coordinator hears. What the supervisor is asked to start, it answers once; of every service it tells the death, once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// Somebody wants another stage in the slot.
    Request(Request),
    /// The candidate in the shadow is to take over.
    Promote {
        /// Until when that waits for a tick of the slot, ms.
        until_ms: u64,
    },
    /// The shadow is not wanted any more; one that was promoted meanwhile is.
    Cancel,
    /// The candidate runs.
    Spawned {
        /// Its incarnation.
        incarnation: u32,
    },
    /// The candidate could not be started.
    SpawnFailed {
        /// Why, for people.
        cause: String,
    },
    /// The candidate has opened its topics.
    Ready {
        /// Its incarnation.
        incarnation: u32,
    },
    /// A service says how it is.
    Health {
        /// Its incarnation.
        incarnation: u32,
        /// How it stands to the slot.
        status: OwnershipStatus,
        /// It has given out what cannot be: NaN, infinity, or a state that is none.
        flawed: bool,
    },
    /// A service has ended.
    Died {
        /// The incarnation that it was.
        incarnation: u32,
    },
    /// The active stage runs again: the answer to [`Action::RestartActive`].
    Restarted {
        /// Its incarnation.
        incarnation: u32,
    },
    /// The slot's owner has ended and is not started again.
    Vacated,
    /// Everything before this tick has been published in the slot.
    Published {
        /// The tick that comes next.
        next_tick: u64,
    },
    /// The slot's input has come this far.
    NewestInput {
        /// Its newest tick.
        tick: u64,
    },
    /// The checkpoint of every reader of the slot has come this far: none of them needs what was published before.
    ReadersKeep {
        /// The tick that the last of them goes on with.
        next_tick: u64,
    },
    /// Time has passed.
    Time,
}

/// What the supervisor is to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Start the stage as a candidate: `OutputGate::candidate(its incarnation, epoch, …)`.
    SpawnCandidate {
        /// The stage.
        stage: String,
        /// The decision in force.
        epoch: u32,
    },
    /// Start the stage in the place of the owner that has ended, from the same checkpoint as [`Action::RestartActive`]:
    /// `OutputGate::owner(its incarnation, epoch, from_tick, …)`. A candidate that is there by now is killed, and the former owner is not
    /// started while the stage lives.
    SpawnOwner {
        /// The stage.
        stage: String,
        /// The decision under which it publishes.
        epoch: u32,
        /// The first tick that it publishes.
        from_tick: u64,
    },
    /// Tell every service of the slot, and its readers. An owner 0 is nobody.
    PublishControl(Control),
    /// End the candidate, by force if it has to be.
    EndCandidate {
        /// Its incarnation.
        incarnation: u32,
    },
    /// End the stage that had the slot.
    RetireOld {
        /// Its incarnation.
        incarnation: u32,
    },
    /// Start the slot's owner anew from its last checkpoint, `OutputGate::owner(its incarnation, epoch, from_tick, …)`; end it first if it
    /// still runs.
    RestartActive {
        /// The decision under which it publishes.
        epoch: u32,
        /// The first tick that it publishes.
        from_tick: u64,
    },
    /// Tell whoever asked. After a commitment the slot's owner is the stage of the report.
    Answer(Report),
}

/// How a request ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// The request's number.
    pub id: u64,
    /// The stage that was to fill the slot.
    pub stage: String,
    /// Which way it ended.
    pub outcome: Outcome,
    /// Why it did not succeed.
    pub reason: Option<Reason>,
    /// The first tick of the new stage, if it took over.
    pub commit_tick: Option<u64>,
    /// The decision in force.
    pub epoch: u32,
    /// Time from the request to this answer, ms.
    pub took_ms: u64,
}

/// Which way a request ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// The new stage has the slot.
    Committed,
    /// Nothing was begun.
    Refused,
    /// The old stage has the slot.
    Aborted,
}

/// Why a request did not succeed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// Another swap of this slot is under way.
    Busy {
        /// That request's number.
        id: u64,
    },
    /// The slot's own stage is being restarted.
    ActiveDown,
    /// It could not be started.
    SpawnFailed {
        /// Why, for people.
        cause: String,
    },
    /// It did not open its topics in time.
    NotReady {
        /// The time that it had, ms.
        ready_ms: u64,
    },
    /// It did not catch up in time, or fell behind again.
    NotCaughtUp {
        /// How far it was behind, where that is known.
        lag_ticks: Option<u64>,
    },
    /// The active stage itself did not keep up with its input: the change of hands would be a gap.
    ActiveBehind {
        /// How far it is behind its input.
        lag_ticks: u64,
    },
    /// It gave out what cannot be.
    Flawed,
    /// It ended.
    CandidateDied,
    /// It no longer kept the tick from which it was to publish.
    CandidateMissed,
    /// The active stage had passed the tick at which it was to stop.
    ActiveMissed,
    /// The active stage ended, beside which the candidate was to run.
    ActiveDied,
    /// No tick came out of the slot.
    NoTick,
    /// It was not confirmed in time that the one has stopped and the other has begun.
    NotConfirmed {
        /// The tick at which the slot was to change hands.
        from_tick: u64,
    },
    /// Somebody asked for that.
    Cancelled,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Busy { id } => write!(
                f,
                "request {id} for this slot is still under way; a swap ends by itself, a shadow by Ctrl-C where it was asked for"
            ),
            Self::ActiveDown => write!(
                f,
                "the slot's own stage does not run: there is nothing to compare with; `plumb swap` puts another in its place"
            ),
            Self::SpawnFailed { cause } => write!(f, "the new stage could not be started: {cause}"),
            Self::NotReady { ready_ms } => write!(
                f,
                "the new stage had not opened its topics after {ready_ms} ms; `plumb stage test` tells what it does"
            ),
            Self::NotCaughtUp { lag_ticks: None } => {
                write!(
                    f,
                    "the new stage, or the active one, never said how far it is; `plumb ps` tells whether it runs"
                )
            }
            Self::NotCaughtUp { lag_ticks: Some(lag_ticks) } => write!(
                f,
                "the new stage is {lag_ticks} ticks behind; it is slower than its input: `plumb top` tells what else the machine does"
            ),
            Self::ActiveBehind { lag_ticks } => {
                write!(f, "the active stage is {lag_ticks} ticks behind its input; ask again when it keeps up")
            }
            Self::Flawed => {
                write!(f, "the new stage gave out what cannot be an output; `plumb stage test` tells after which input")
            }
            Self::CandidateDied => write!(f, "the new stage ended before it had taken over"),
            Self::CandidateMissed => write!(f, "the decision reached the new stage too late; ask again"),
            Self::ActiveMissed => write!(f, "the decision reached the active stage too late; ask again"),
            Self::ActiveDied => write!(f, "the active stage ended meanwhile and is restarted; ask again"),
            Self::NoTick => write!(
                f,
                "no tick has come out of the slot; does the source give samples? `plumb topic hz imu` tells; ask again when it does"
            ),
            Self::NotConfirmed { from_tick } => write!(
                f,
                "the change of hands at tick {from_tick} was not confirmed in time; does the source still give samples, and the active stage still run? `plumb ps` tells; ask again"
            ),
            Self::Cancelled => write!(f, "cancelled as asked"),
        }
    }
}
