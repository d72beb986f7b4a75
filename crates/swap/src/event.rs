//! Events and actions of the coordinator, and reports about swap requests.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{OwnershipDecision, OwnershipStatus};

/// Deadlines and limits of a swap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwapLimits {
    /// Timeout for the candidate to start and open its topics, ms.
    pub ready_timeout_ms: u64,
    /// Timeout for the candidate to catch up with the active stage, ms.
    pub catch_up_timeout_ms: u64,
    /// Time that the candidate computes in parallel with the active stage before it takes over, ms.
    pub shadow_ms: u64,
    /// Timeout from the decision until the first tick published under it is reported, ms.
    pub commit_timeout_ms: u64,
    /// Timeout for the active stage to resume ownership after a failed swap, ms. Then it is
    /// restarted.
    pub restore_timeout_ms: u64,
    /// Longest time that the previous stage stays after the commitment, without publishing, ms.
    /// Restarting subscribers read from it.
    pub linger_ms: u64,
    /// Interval at which the stop of a service is requested until it has exited, ms.
    pub stop_retry_ms: u64,
    /// Maximum lag at the hand-over, ticks: of the candidate behind the active stage, and of the
    /// active stage behind its input.
    pub max_lag_ticks: u64,
    /// Ticks between the newest known one and the first one of the new owner.
    ///
    /// They cover the delivery time of the decision. Each further attempt doubles them.
    pub margin_ticks: u64,
}

/// Request for a swap or a shadow.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// Number of the request, repeated in its report.
    pub id: u64,
    /// Stage for the slot.
    pub stage: String,
    /// Whether the candidate only computes in parallel until it is promoted or cancelled.
    pub shadow_only: bool,
    /// Deadline for a tick of the slot, ms; `u64::MAX` for a shadow.
    pub deadline_ms: u64,
    /// Number of earlier attempts in which the decision came too late.
    pub previous_attempts: u32,
}

impl SwapLimits {
    /// Returns the margin of an attempt, ticks.
    pub fn margin_ticks(&self, previous_attempts: u32) -> u64 {
        self.margin_ticks.saturating_mul(1 << previous_attempts.min(16))
    }
}

/// Input of the coordinator.
///
/// The supervisor reports the result of each requested start once, and the exit of each service
/// once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A client requests another stage for the slot.
    Request(Request),
    /// The shadow is to take over.
    Promote {
        /// Deadline for a tick of the slot, ms.
        deadline_ms: u64,
    },
    /// The shadow is cancelled. A shadow that was promoted in the meantime is kept.
    Cancel,
    /// The candidate process runs.
    Spawned {
        /// Incarnation of the candidate.
        incarnation: u32,
    },
    /// The candidate could not be started.
    SpawnFailed {
        /// Cause, for the report.
        cause: String,
    },
    /// The candidate has opened its topics.
    Ready {
        /// Incarnation of the candidate.
        incarnation: u32,
    },
    /// A service reports its health.
    Health {
        /// Incarnation of the service.
        incarnation: u32,
        /// Ownership state of the service.
        status: OwnershipStatus,
        /// Whether the service has returned an invalid output: NaN, infinity, or an invalid state.
        invalid_output: bool,
    },
    /// A service has exited.
    Exited {
        /// Incarnation of the service.
        incarnation: u32,
    },
    /// The active stage runs again, as requested by [`Action::RestartActive`].
    Restarted {
        /// Incarnation of the new process.
        incarnation: u32,
    },
    /// The owner of the slot has exited and is not restarted.
    Vacated,
    /// All ticks before this one have been published in the slot.
    Published {
        /// First tick that is not published yet.
        next_tick: u64,
    },
    /// The input of the slot has advanced.
    NewestInput {
        /// Newest tick of the input.
        tick: u64,
    },
    /// The checkpoints of all subscribers have reached a tick. No subscriber needs earlier outputs.
    SubscribersCheckpointed {
        /// Lowest tick from which a subscriber resumes.
        next_tick: u64,
    },
    /// Time has passed.
    TimePassed,
}

/// Output of the coordinator: a task for the supervisor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Starts the stage as a candidate, with `OutputGate::candidate(its incarnation, epoch, …)`.
    SpawnCandidate {
        /// Name of the stage.
        stage: String,
        /// Epoch in force.
        epoch: u32,
    },
    /// Starts the stage in place of an owner that has exited.
    ///
    /// It resumes from the same checkpoint as [`Action::RestartActive`], with
    /// `OutputGate::owner(its incarnation, epoch, from_tick, …)`. An existing candidate is killed,
    /// and the former owner is not restarted while the stage lives.
    SpawnOwner {
        /// Name of the stage.
        stage: String,
        /// Epoch under which it publishes.
        epoch: u32,
        /// First tick that it publishes.
        from_tick: u64,
    },
    /// Publishes a decision to the services of the slot and its subscribers. Owner 0 means none.
    PublishDecision(OwnershipDecision),
    /// Stops the candidate, by force if necessary.
    StopCandidate {
        /// Incarnation of the candidate.
        incarnation: u32,
    },
    /// Stops the stage that owned the slot before.
    RetirePrevious {
        /// Incarnation of that stage.
        incarnation: u32,
    },
    /// Restarts the owner of the slot from its last checkpoint, with `OutputGate::owner(its
    /// incarnation, epoch, from_tick, …)`.
    ///
    /// A process that still runs is stopped first.
    RestartActive {
        /// Epoch under which it publishes.
        epoch: u32,
        /// First tick that it publishes.
        from_tick: u64,
    },
    /// Reports the result to the requester. After a commitment, the stage of the report owns the
    /// slot.
    Report(Report),
}

/// Result of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// Number of the request.
    pub id: u64,
    /// Requested stage.
    pub stage: String,
    /// Outcome of the request.
    pub outcome: SwapOutcome,
    /// Cause of a failure.
    pub reason: Option<FailureReason>,
    /// First tick of the new stage, if it took over.
    pub commit_tick: Option<u64>,
    /// Epoch in force.
    pub epoch: u32,
    /// Time from the request to the report, ms.
    pub took_ms: u64,
}

/// Outcome of a swap request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SwapOutcome {
    /// The new stage owns the slot.
    Committed,
    /// The request was refused; nothing was started.
    Refused,
    /// The previous stage owns the slot.
    Aborted,
}

/// Cause of a failed swap request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailureReason {
    /// Another swap of the slot is in progress.
    Busy {
        /// Number of that request.
        id: u64,
    },
    /// The active stage does not run.
    ActiveDown,
    /// The candidate could not be started.
    SpawnFailed {
        /// Cause, for the report.
        cause: String,
    },
    /// The candidate did not open its topics in time.
    NotReady {
        /// Timeout, ms.
        ready_timeout_ms: u64,
    },
    /// The candidate did not catch up in time, or fell behind again.
    NotCaughtUp {
        /// Lag of the candidate, if known.
        lag_ticks: Option<u64>,
    },
    /// The active stage lags behind its input, so that the hand-over would leave a gap.
    ActiveBehind {
        /// Lag of the active stage.
        lag_ticks: u64,
    },
    /// The candidate returned an invalid output.
    InvalidOutput,
    /// The candidate exited.
    CandidateExited,
    /// The candidate no longer held its first tick.
    CandidateMissed,
    /// The active stage had passed the tick at which it was to stop.
    ActiveMissed,
    /// The active stage exited while the candidate computed in parallel.
    ActiveExited,
    /// The slot produced no tick.
    NoTick,
    /// The hand-over was not confirmed before its deadline.
    NotConfirmed {
        /// Tick of the hand-over.
        from_tick: u64,
    },
    /// The request was cancelled.
    Cancelled,
}

impl fmt::Display for FailureReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Busy { id } => write!(
                f,
                "request {id} for this slot is in progress; wait until it has ended, or stop a shadow with Ctrl-C in its terminal"
            ),
            Self::ActiveDown => write!(
                f,
                "the active stage of the slot does not run, so there is no output to compare with; replace it with `plumb swap`"
            ),
            Self::SpawnFailed { cause } => write!(f, "cannot start the new stage: {cause}"),
            Self::NotReady { ready_timeout_ms } => write!(
                f,
                "the new stage did not open its topics within {ready_timeout_ms} ms; check it with `plumb stage test`"
            ),
            Self::NotCaughtUp { lag_ticks: None } => {
                write!(
                    f,
                    "the new stage or the active one never reported its position; `plumb ps` shows whether both run"
                )
            }
            Self::NotCaughtUp { lag_ticks: Some(lag_ticks) } => write!(
                f,
                "the new stage is {lag_ticks} ticks behind and slower than its input; `plumb top` shows the load of the machine"
            ),
            Self::ActiveBehind { lag_ticks } => {
                write!(f, "the active stage is {lag_ticks} ticks behind its input; retry when it has caught up")
            }
            Self::InvalidOutput => {
                write!(f, "the new stage returned an invalid output; `plumb stage test` shows the input that causes it")
            }
            Self::CandidateExited => write!(f, "the new stage exited before it had taken over"),
            Self::CandidateMissed => write!(f, "the decision reached the new stage too late; retry"),
            Self::ActiveMissed => write!(f, "the decision reached the active stage too late; retry"),
            Self::ActiveExited => write!(f, "the active stage exited during the swap and is being restarted; retry"),
            Self::NoTick => write!(
                f,
                "the slot produced no tick; check with `plumb topic hz imu` that the source delivers samples, and retry"
            ),
            Self::NotConfirmed { from_tick } => write!(
                f,
                "the hand-over at tick {from_tick} was not confirmed in time; check with `plumb ps` that the source and the active stage run, and retry"
            ),
            Self::Cancelled => write!(f, "cancelled as requested"),
        }
    }
}
