//! Ownership of the slots, and the swap requests in progress.

use foreign::ForeignText;
use launch::{Service, Slot, StageConfig};
use swap::{Coordinator, SwapState};

use super::stage_history::{StageHistory, StageInstance};

/// Slots of a system, with their coordinators and swap requests.
#[derive(Debug, Default)]
pub(crate) struct Swaps {
    pub(crate) slots: Vec<SlotState>,
    pub(crate) requests: u64,
    /// Requests that wait until the previous swap of their slot has finished.
    pub(crate) queued: Vec<(Slot, StageConfig, swap::Request)>,
}

#[derive(Debug)]
pub(crate) struct SlotState {
    pub(crate) slot: Slot,
    pub(crate) coordinator: Coordinator,
    pub(crate) candidate: Option<StageConfig>,
    pub(crate) history: StageHistory,
    pub(crate) candidate_instance: Option<StageInstance>,
    /// Set if the newest decision names a replacement for a failed owner. That replacement may have
    /// published already.
    pub(crate) owned_by_replacement: bool,
    pub(crate) attempt: Attempt,
    pub(crate) ready_reported: bool,
    /// Last output on standard error of the slot's most recently exited process.
    pub(crate) last_stderr: ForeignText,
}

/// Most recently started request and the number of its attempts.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Attempt {
    pub(crate) id: u64,
    pub(crate) deadline_ms: u64,
    pub(crate) count: u32,
}

impl Attempt {
    pub(crate) fn start(&mut self, request: &swap::Request) {
        let count = if self.id == request.id { self.count + 1 } else { 1 };
        *self = Self { id: request.id, deadline_ms: request.deadline_ms, count };
    }
}

impl Swaps {
    /// Returns `true` if a checkpoint is valid under the current ownership of the slot.
    pub(crate) fn accepts_checkpoint(&mut self, service: u32, incarnation: u32, next_tick: u64) -> bool {
        let state = self.slots.iter_mut().find(|state| Service::from(state.slot) as u32 == service);
        state.is_none_or(|state| state.coordinator.admits_checkpoint(incarnation, next_tick))
    }

    /// Returns the current epoch of a slot.
    pub(crate) fn epoch(&self, slot: Slot) -> Option<u32> {
        Some(self.state(slot)?.coordinator.epoch())
    }

    pub(crate) fn record_stderr(&mut self, service: Service, stderr: &ForeignText) {
        if let Some(state) = service.slot().and_then(|slot| self.state_mut(slot)) {
            state.last_stderr = stderr.clone();
        }
    }

    /// Returns the candidate instance of a slot.
    pub(crate) fn candidate_instance(&self, slot: Slot) -> Option<&StageInstance> {
        self.state(slot)?.candidate_instance.as_ref()
    }

    /// Returns the stages that have owned a slot.
    pub(crate) fn history(&self, slot: Slot) -> Option<&StageHistory> {
        Some(&self.state(slot)?.history)
    }

    pub(crate) fn is_active(&self) -> bool {
        self.slots.iter().any(|state| state.coordinator.state() != SwapState::Idle)
    }

    pub(crate) fn slots(&self) -> Vec<Slot> {
        self.slots.iter().map(|state| state.slot).collect()
    }

    pub(crate) fn state(&self, slot: Slot) -> Option<&SlotState> {
        self.slots.iter().find(|state| state.slot == slot)
    }

    pub(crate) fn state_mut(&mut self, slot: Slot) -> Option<&mut SlotState> {
        self.slots.iter_mut().find(|state| state.slot == slot)
    }
}
