//! Requests to a running system and their replies, as sent over the control socket.

use std::fmt;

use foreign::ForeignText;
use graph::StageConfig;
use serde::{Deserialize, Serialize};
use swap::SwapOutcome;

/// Request from a client or a service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlRequest {
    /// Swap the stage of a slot.
    Swap(SwapRequest),
    /// Stop a shadow.
    Cancel {
        /// Slot of the shadow.
        slot: String,
    },
    /// Return the status of every service.
    Status,
    /// Return the service configuration, with the stages that currently fill the slots.
    ServiceConfig,
    /// Return the record status: the data missing so far from the report and the output file.
    RecordStatus,
    /// Show a line from a service to the user.
    Announce {
        /// Reporting service.
        service: String,
        /// Text to show.
        line: String,
    },
    /// Set the list of problems with the input of a service. The previous list is discarded.
    Diagnostics {
        /// Reporting service.
        service: String,
        /// All current problems. May be empty.
        diagnostics: Vec<Diagnostic>,
    },
    /// Announce the address at which a service can be reached.
    Address {
        /// Reporting service.
        service: String,
        /// Address. A fragment after `#` grants access and is shown only in the terminal.
        address: String,
    },
}

/// Problem with the input of a service.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnostic {
    /// Short identifier of the problem. A service reports at most one problem of each kind.
    pub kind: ForeignText,
    /// Description of the problem found.
    pub found: ForeignText,
    /// Suggested remedy.
    pub remedy: ForeignText,
}

/// Data missing from the report and the output file of a running system.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordStatus {
    /// Number of attitudes that were published but not collected by the supervisor.
    pub not_recorded: u64,
    /// Failure of the output file or the recording; `None` while both are being written.
    pub output_error: Option<String>,
}

/// Request to swap the stage of a slot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapRequest {
    /// Slot name.
    pub slot: String,
    /// Requested stage.
    pub stage: StageConfig,
    /// Shadow mode: the stage runs but does not take over.
    pub shadow: bool,
    /// Epoch that the client expects the slot to have. If it differs, the request is rejected.
    pub expected_epoch: Option<u32>,
    /// Time limit for the commit, ms; `None` for no limit, as for shadows.
    pub timeout_ms: Option<u64>,
}

impl SwapRequest {
    /// Default value of `timeout_ms`, ms.
    pub const DEFAULT_TIMEOUT_MS: u64 = 30_000;
}

/// Outcome of a swap request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapReport {
    /// Slot name.
    pub slot: ForeignText,
    /// Previous stage of the slot; empty if the slot does not exist.
    pub from: ForeignText,
    /// Requested stage.
    pub to: ForeignText,
    /// First tick of the new stage; `None` if it did not take over.
    pub commit_tick: Option<u64>,
    /// Number of ticks lost since the request.
    pub lost: u64,
    /// Number of attitudes published more than once since the request.
    pub duplicated: u64,
    /// Longest interval between consecutive attitudes since the request, µs.
    pub gap_us: f64,
    /// Attitude jump at the commit tick, degrees.
    pub jump_deg: f64,
    /// Outcome: committed, rejected or aborted.
    pub outcome: SwapOutcome,
    /// Reason if the swap was not committed, shown to the user. It can contain output of a stage.
    pub reason: Option<ForeignText>,
}

impl SwapReport {
    /// Creates the report of a swap that was not committed.
    pub fn failed(slot: String, from: String, to: String, outcome: SwapOutcome, reason: String) -> Self {
        let (lost, duplicated, gap_us, jump_deg) = (0, 0, 0.0, 0.0);
        let ([slot, from, to], reason) = ([slot, from, to].map(ForeignText::from), reason.into());
        Self { slot, from, to, commit_tick: None, lost, duplicated, gap_us, jump_deg, outcome, reason: Some(reason) }
    }
}

impl fmt::Display for SwapReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = self;
        match (outcome, commit_tick) {
            (SwapOutcome::Committed, Some(tick)) => {
                let gap_ms = gap_us * 1e-3;
                write!(
                    f,
                    "{slot}: {from} → {to} from tick {tick}; lost {lost}, duplicated {duplicated}, longest interval {gap_ms:.1} ms, jump {jump_deg:.3}°"
                )
            }
            _ => {
                let reason = reason.clone().unwrap_or_else(|| "no reason given".into());
                let reason = reason.with_lines();
                let unchanged = if from.raw().is_empty() { String::new() } else { format!(" unchanged ({from})") };
                write!(f, "{slot}{unchanged}: {reason}")
            }
        }
    }
}

/// Status of a service.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ServiceStatus {
    /// Service name.
    pub service: ForeignText,
    /// Stage that fills the slot; `None` for services without a slot.
    pub stage: Option<ForeignText>,
    /// State in one word, such as "running" or "failed".
    pub state: ForeignText,
    /// Process ID; `None` while no process runs.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u32,
    /// Incarnation of the process, unique in the system; 0 while no process runs.
    pub incarnation: u32,
    /// Current epoch of the slot; 0 for services without a slot.
    pub epoch: u32,
    /// Number of ticks published.
    pub ticks: u64,
    /// Number of ticks lost.
    pub lost: u64,
    /// Address at which the service can be reached, if it has reported one.
    pub address: Option<ForeignText>,
    /// Problems with the input of the service.
    pub diagnostics: Vec<Diagnostic>,
}
