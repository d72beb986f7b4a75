//! Records of a run: its clients and its swaps.

use std::{collections::BTreeMap, ops::RangeInclusive};

use launch::Service;

use crate::reference::{CommittedSwap, SwapsBySlot};

/// Client that sends one request to the supervisor.
#[derive(Debug)]
pub(crate) struct Client {
    pub(crate) description: String,
    pub(crate) replies: u32,
    /// Time in ms at which the client disconnects; `None` if it waits for the reply.
    pub(crate) disconnect_ms: Option<u64>,
    pub(crate) disconnected: bool,
}

/// Swaps of a run.
#[derive(Debug, Default)]
pub(crate) struct SwapRecord {
    pub(crate) candidates: BTreeMap<u32, Candidate>,
    pub(crate) committed: SwapsBySlot,
    pub(crate) count: u64,
    /// Set if some ticks may be from either of two stages, so that the output cannot be compared.
    pub(crate) ambiguous: bool,
    /// Newest epoch of the fuser.
    pub(crate) fuser_epoch: u32,
    /// Ranges of ticks in which subscribers may see a new epoch of the fuser although no swap took
    /// place.
    pub(crate) fuser_epoch_changes: Vec<RangeInclusive<u64>>,
}

impl SwapRecord {
    /// Returns `true` if a slot was swapped to a different stage.
    pub(crate) fn has_stage_change(&self) -> bool {
        self.committed.values().flatten().any(|committed| committed.changes_stage)
    }

    /// Returns `true` if the course may have counted a swap that the reference run does not
    /// contain.
    ///
    /// The course counts a swap of the fuser when the flag `SWAPPED` coincides with a new epoch of
    /// the fuser. Swaps of gyro and accel set this flag, too. If such a swap coincides with a new
    /// epoch that is not due to a swap of the fuser, the count is wrong.
    pub(crate) fn has_ambiguous_swap_flag(&self) -> bool {
        let before = [Service::Gyro, Service::Accel].into_iter().filter_map(|slot| self.committed.get(slot.name()));
        let mut swapped = before.flatten().filter(|committed| committed.changes_stage);
        let candidates = self.candidates.values().filter(|candidate| candidate.service == Service::Fuser);
        let candidates: Vec<_> = candidates.filter_map(|candidate| candidate.decided_from_tick).collect();
        swapped.any(|CommittedSwap { from_tick, .. }| {
            candidates.contains(from_tick) || self.fuser_epoch_changes.iter().any(|ticks| ticks.contains(from_tick))
        })
    }
}

/// Process that is to take over a slot.
#[derive(Debug)]
pub(crate) struct Candidate {
    pub(crate) service: Service,
    pub(crate) stage: String,
    /// Set if the stage differs from the slot's current stage.
    pub(crate) changes_stage: bool,
    /// First tick after the checkpoint from which the process resumed.
    pub(crate) checkpoint_tick: Option<u64>,
    /// Set if the process was started in place of an exited owner, without a hand-over.
    pub(crate) replaces_exited_owner: bool,
    /// First tick that the process owns, as decided by the supervisor; `None` before the decision.
    pub(crate) decided_from_tick: Option<u64>,
}
