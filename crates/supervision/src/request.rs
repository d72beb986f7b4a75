//! What is asked of a running system, and what is answered, as it is written on the control socket.

use std::fmt;

use launch::Stage;
use serde::{Deserialize, Serialize};
use swap::Outcome;

/// What may be asked of a running system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlRequest {
    /// Swap what fills a slot.
    Swap(SwapRequest),
    /// End a shadow.
    Cancel {
        /// The slot.
        slot: String,
    },
    /// How the services are.
    Ps,
    /// What was to run, with the stages that fill the slots by now.
    ServiceConfig,
    /// What the report and the file lack by now.
    Record,
    /// A service has something to say to people.
    Tell {
        /// Which one.
        service: String,
        /// A line.
        what: String,
    },
    /// A service says what is wrong with what it reads, all of it.
    Troubles {
        /// Which one.
        service: String,
        /// Nothing if all is well.
        troubles: Vec<Trouble>,
    },
    /// A service says where it can be reached.
    At {
        /// Which one.
        service: String,
        /// Its address.
        at: String,
    },
}

/// Something that is wrong with what a service reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trouble {
    /// What it is, in a word; one of a kind at a time.
    pub kind: String,
    /// What was found.
    pub found: String,
    /// What to do about it.
    pub remedy: String,
}

/// What the report of a running system and its file lack.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordStatus {
    /// Attitudes that were published and not taken.
    pub not_recorded: u64,
    /// Why nothing more is written to the file.
    pub out_ended: Option<String>,
}

/// A swap that somebody asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapRequest {
    /// The slot.
    pub slot: String,
    /// What is to fill it.
    pub stage: Stage,
    /// It is to compute beside the active stage and no more.
    pub shadow: bool,
    /// The last decision about the slot that whoever asks knows of; with another it is refused.
    pub expected_epoch: Option<u32>,
    /// How long it waits for a tick to come out of the slot, ms; a shadow waits for as long as it is asked for.
    pub limit_ms: Option<u64>,
}

impl SwapRequest {
    /// How long somebody waits who says nothing of that, ms.
    pub const LIMIT_MS: u64 = 30_000;
}

/// How a swap went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapReport {
    /// The slot.
    pub slot: String,
    /// The stage that filled it.
    pub from: String,
    /// The stage that was to.
    pub to: String,
    /// The first tick of the new stage.
    pub commit_tick: Option<u64>,
    /// Ticks lost since the request.
    pub lost: u64,
    /// Attitudes that came again since the request.
    pub duplicated: u64,
    /// The longest interval between two attitudes since the request, µs.
    pub gap_us: f64,
    /// By how much the attitude jumped at the commit tick, degrees.
    pub jump_deg: f64,
    /// "committed", "refused" or "aborted".
    pub outcome: Outcome,
    /// Why not, for people.
    pub reason: Option<String>,
}

impl SwapReport {
    /// The report of a swap that did not happen.
    pub(crate) fn failed(slot: String, from: String, to: String, outcome: Outcome, reason: String) -> Self {
        let (lost, duplicated, gap_us, jump_deg) = (0, 0, 0.0, 0.0);
        Self { slot, from, to, commit_tick: None, lost, duplicated, gap_us, jump_deg, outcome, reason: Some(reason) }
    }
}

impl fmt::Display for SwapReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = self;
        match (outcome, commit_tick) {
            (Outcome::Committed, Some(tick)) => {
                let gap_ms = gap_us * 1e-3;
                write!(
                    f,
                    "{slot}: {from} → {to} from tick {tick}; lost {lost}, duplicated {duplicated}, longest interval {gap_ms:.1} ms, jump {jump_deg:.3}°"
                )
            }
            _ => {
                let reason = reason.as_deref().unwrap_or("no reason given");
                let stays = if from.is_empty() { String::new() } else { format!(" {from} stays:") };
                write!(f, "{slot}:{stays} {reason}")
            }
        }
    }
}

/// How a service is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServiceStatus {
    /// Its name.
    pub service: String,
    /// What fills its slot.
    pub stage: Option<String>,
    /// What it does, in a word.
    pub state: String,
    /// Its process, where there is one.
    pub pid: Option<u32>,
    /// Times it was started again.
    pub restarts: u32,
    /// The number of its process among all of the system.
    pub incarnation: u32,
    /// The last decision about its slot; 0 where it has none.
    pub epoch: u32,
    /// Ticks published.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Where it can be reached.
    pub at: Option<String>,
    /// What is wrong with what it reads.
    pub troubles: Vec<Trouble>,
}
