//! What is noted of a world while it goes on: who asks, and the swaps.

use std::{collections::BTreeMap, ops::RangeInclusive};

use launch::Service;

use crate::reference::{Committed, Swaps};

/// Somebody who asks.
#[derive(Debug)]
pub(crate) struct Caller {
    pub(crate) what: String,
    pub(crate) answers: u32,
    /// When it goes away.
    pub(crate) leaves_ms: Option<u64>,
    pub(crate) gone: bool,
}

/// The swaps of a world.
#[derive(Debug, Default)]
pub(crate) struct SwapRecord {
    pub(crate) candidates: BTreeMap<u32, Candidate>,
    pub(crate) committed: Swaps,
    pub(crate) count: u64,
    /// Some ticks may have come of the one stage or of the other.
    pub(crate) either: bool,
    /// The last decision about the fuser, and between which ticks its readers have come to one that is no commitment.
    pub(crate) fuser_epoch: u32,
    pub(crate) renumbered: Vec<RangeInclusive<u64>>,
}

impl SwapRecord {
    /// A stage of another kind fills a slot.
    pub(crate) fn has_swapped(&self) -> bool {
        self.committed.values().flatten().any(|committed| committed.other)
    }

    /// The course knows a fuser of another kind by a flag that every slot sets, under a new decision about the fuser. Where that decision is
    /// no commitment and another slot's stage takes over at that very tick, it counts one swap that a reference does not know.
    pub(crate) fn is_mistakable(&self) -> bool {
        let before = [Service::Gyro, Service::Accel].into_iter().filter_map(|slot| self.committed.get(slot.name()));
        let mut swapped = before.flatten().filter(|committed| committed.other);
        let left = self.candidates.values().filter(|candidate| candidate.service == Service::Fuser);
        let left: Vec<_> = left.filter_map(|candidate| candidate.decided_from).collect();
        swapped.any(|Committed { from_tick, .. }| {
            left.contains(from_tick) || self.renumbered.iter().any(|ticks| ticks.contains(from_tick))
        })
    }
}

#[derive(Debug)]
pub(crate) struct Candidate {
    pub(crate) service: Service,
    pub(crate) stage: String,
    /// Another stage than before.
    pub(crate) other: bool,
    pub(crate) checkpoint_tick: Option<u64>,
    /// It began in the place of an owner that had ended.
    pub(crate) alone: bool,
    pub(crate) decided_from: Option<u64>,
}
