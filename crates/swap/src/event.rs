//! Events and actions of the coordinator, and reports on swap requests.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{OwnershipDecision, OwnershipStatus};

/// Deadlines and limits of a swap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwapLimits {
    /// Timeout in ms for the candidate to start and open its topics.
    pub ready_timeout_ms: u64,
    /// Timeout in ms for the candidate to catch up with the active stage.
    pub catch_up_timeout_ms: u64,
    /// Time in ms for which the candidate computes in parallel with the active stage before it
    /// takes over.
    pub shadow_ms: u64,
    /// Timeout in ms for the hand-over to be confirmed after the decision.
    pub commit_timeout_ms: u64,
    /// Timeout in ms for the active stage to resume ownership after a failed swap. After that, the
    /// active stage is restarted.
    pub restore_timeout_ms: u64,
    /// Longest time in ms for which the previous stage keeps running after the swap is committed.
    /// The previous stage publishes nothing new, but subscribers that restart receive its history.
    pub linger_ms: u64,
    /// Interval in ms at which the stop request to a service is repeated until the service has
    /// exited.
    pub stop_retry_ms: u64,
    /// Maximum lag at the hand-over, in ticks. The limit applies to the lag of the candidate behind
    /// the active stage and to the lag of the active stage behind its input.
    pub max_lag_ticks: u64,
    /// Number of ticks from the newest known tick to the first tick of the new owner.
    ///
    /// This margin covers the delivery time of the decision. It is doubled for each further
    /// attempt.
    pub margin_ticks: u64,
}

/// Request for a swap or a shadow.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// ID of the request, which is repeated in its report.
    pub id: u64,
    /// Name of the requested stage.
    pub stage: String,
    /// `true` if the candidate only computes in parallel with the active stage until it is promoted
    /// or cancelled.
    pub shadow_only: bool,
    /// Time in ms by which the slot must have produced its first tick; `u64::MAX` for a shadow.
    pub deadline_ms: u64,
    /// Number of earlier attempts that failed because the decision came too late.
    pub previous_attempts: u32,
}

impl SwapLimits {
    /// Returns the margin in ticks after `previous_attempts` failed attempts.
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
    /// Request for the shadow to take over.
    Promote {
        /// Time in ms by which the slot must have produced its first tick.
        deadline_ms: u64,
    },
    /// The shadow is cancelled. A shadow that has been promoted in the meantime is kept.
    Cancel,
    /// The candidate process is running.
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
        /// Ticks that the service has computed and skipped.
        progress: Progress,
        /// `true` if the service has returned an invalid output: NaN, infinity, or an invalid
        /// state.
        invalid_output: bool,
    },
    /// A service has exited.
    Exited {
        /// Incarnation of the service.
        incarnation: u32,
    },
    /// The active stage is running again, as requested by [`Action::RestartActive`].
    Restarted {
        /// Incarnation of the new process.
        incarnation: u32,
    },
    /// The owner of the slot has exited and is not restarted.
    Vacated,
    /// All ticks before `next_tick` have been published in the slot.
    Published {
        /// First tick that has not been published yet.
        next_tick: u64,
    },
    /// The input of the slot has advanced.
    NewestInput {
        /// Newest tick of the input.
        tick: u64,
    },
    /// The checkpoints of all subscribers have reached `next_tick`. No subscriber needs earlier
    /// outputs.
    SubscribersCheckpointed {
        /// Lowest tick from which a subscriber resumes.
        next_tick: u64,
    },
    /// Time has passed.
    TimePassed,
}

/// Progress of a service when it reported its health.
///
/// Unlike [`OwnershipStatus::next_tick`], which may include newer ticks, both values are from the
/// same report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Progress {
    /// Next tick to compute.
    pub next_tick: u64,
    /// Number of earlier ticks that were skipped. A service inherits this number with the
    /// checkpoint from which it resumes.
    pub lost: u64,
}

/// Output of the coordinator: a task for the supervisor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Starts the stage as a candidate. The process creates its gate with
    /// `OutputGate::candidate(incarnation, epoch, …)`.
    SpawnCandidate {
        /// Name of the stage.
        stage: String,
        /// Current epoch.
        epoch: u32,
    },
    /// Starts the stage in place of an owner that has exited.
    ///
    /// The stage resumes from the same checkpoint as in [`Action::RestartActive`]. The process
    /// creates its gate with `OutputGate::owner(incarnation, epoch, from_tick, …)`. An existing
    /// candidate is killed, and the former owner is not restarted while the new stage is running.
    SpawnOwner {
        /// Name of the stage.
        stage: String,
        /// Epoch under which the stage publishes.
        epoch: u32,
        /// First tick that the stage publishes.
        from_tick: u64,
    },
    /// Publishes a decision to the services and the subscribers of the slot. Owner 0 means no
    /// owner.
    PublishDecision(OwnershipDecision),
    /// Stops the candidate, by force if necessary.
    StopCandidate {
        /// Incarnation of the candidate.
        incarnation: u32,
    },
    /// Stops the stage that previously owned the slot.
    RetirePrevious {
        /// Incarnation of the previous stage.
        incarnation: u32,
    },
    /// Restarts the owner of the slot from its last checkpoint. The process creates its gate with
    /// `OutputGate::owner(incarnation, epoch, from_tick, …)`.
    ///
    /// If the owner is still running, it is stopped first.
    RestartActive {
        /// Epoch under which the owner publishes.
        epoch: u32,
        /// First tick that the owner publishes.
        from_tick: u64,
    },
    /// Reports the result to the client. If the swap was committed, the stage named in the report
    /// owns the slot.
    Report(Report),
}

/// Result of a swap request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// ID of the request.
    pub id: u64,
    /// Name of the requested stage.
    pub stage: String,
    /// Outcome of the request.
    pub outcome: SwapOutcome,
    /// Reason why the swap was refused or failed; `None` if it was committed.
    pub reason: Option<FailureReason>,
    /// First tick of the new stage, if it took over.
    pub commit_tick: Option<u64>,
    /// Current epoch.
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
    /// The request was rejected, and nothing was started.
    Refused,
    /// The swap failed, and the previous stage owns the slot.
    Aborted,
}

/// Cause of a failed swap request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailureReason {
    /// Another swap of the slot is in progress.
    Busy {
        /// ID of the request for the swap in progress.
        id: u64,
    },
    /// The active stage is not running.
    ActiveDown,
    /// The candidate could not be started.
    SpawnFailed {
        /// Cause, for the report.
        cause: String,
    },
    /// The candidate did not open its topics in time.
    NotReady {
        /// Timeout for the candidate to open its topics, ms.
        ready_timeout_ms: u64,
    },
    /// The candidate did not catch up in time, or fell behind again.
    NotCaughtUp {
        /// Lag of the candidate behind the active stage, if known.
        lag_ticks: Option<u64>,
    },
    /// The candidate has skipped ticks that the active stage has processed, so its state is wrong.
    InputMissed {
        /// Number of these ticks.
        ticks: u64,
    },
    /// The active stage lags behind its input, so that the hand-over would leave a gap.
    ActiveBehind {
        /// Lag of the active stage behind its input.
        lag_ticks: u64,
    },
    /// The candidate returned an invalid output.
    InvalidOutput,
    /// The candidate exited.
    CandidateExited,
    /// The candidate no longer held its output of the hand-over tick.
    CandidateMissed,
    /// The active stage had already passed the tick at which it had to stop.
    ActiveMissed,
    /// The active stage exited while the candidate was computing in parallel.
    ActiveExited,
    /// The slot produced no tick before the deadline.
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
            Self::InputMissed { ticks } => write!(
                f,
                "the new stage missed {ticks} ticks of its input, because it started or computed more slowly than the topics hold; retry, or raise `buffer_s` in the launch file"
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
