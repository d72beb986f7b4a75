//! What somebody asks for, and how it went.

use std::fmt;

use launch::Stage;
use serde::{Deserialize, Serialize};
use swap::Outcome;

/// What somebody asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Wish {
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

impl Wish {
    /// How long somebody waits who says nothing of that, ms.
    pub const LIMIT_MS: u64 = 30_000;
}

/// How it went.
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
