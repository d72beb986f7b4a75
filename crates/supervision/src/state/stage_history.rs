//! Stages that have owned a slot.

use launch::StageConfig;
use messages::SystemEvent;
use swap::Resume;

/// Maximum number of stages remembered per slot.
const MAX_INSTANCES: usize = 64;

/// Stage that owns, or is about to own, a slot.
#[derive(Debug, Clone)]
pub(crate) struct StageInstance {
    /// Number within the slot: 0 for the launch file's stage, incremented for each candidate. A
    /// restart keeps the number.
    pub(crate) number: u32,
    pub(crate) stage: StageConfig,
    /// Tick of the checkpoint that the instance was started from; `None` after a fresh start.
    pub(crate) restored_tick: Option<u64>,
    /// Number of the instance that wrote the checkpoint of `restored_tick`.
    pub(crate) restored_from: u32,
    /// Tick after the newest one published by the failed predecessor; `None` unless the instance
    /// replaced a failed owner.
    pub(crate) predecessor_end: Option<u64>,
}

/// Stages that have owned a slot, the current owner last.
#[derive(Debug, Clone)]
pub(crate) struct StageHistory {
    instances: Vec<StageInstance>,
    next_number: u32,
}

impl StageHistory {
    /// Creates the history of a slot with the launch file's stage.
    pub(crate) fn new(stage: StageConfig) -> Self {
        let first = StageInstance { number: 0, stage, restored_tick: Some(0), restored_from: 0, predecessor_end: None };
        Self { instances: vec![first], next_number: 1 }
    }

    /// Creates the instance for a new candidate.
    pub(crate) fn new_candidate(
        &mut self,
        stage: StageConfig,
        resume: &Resume,
        predecessor_end: Option<u64>,
    ) -> StageInstance {
        let number = self.next_number;
        self.next_number += 1;
        let restored_tick = resume.next_tick();
        StageInstance { number, stage, restored_tick, restored_from: self.instance_at(restored_tick), predecessor_end }
    }

    /// Appends an instance as the current owner.
    pub(crate) fn push_owner(&mut self, instance: StageInstance) {
        if self.instances.len() == MAX_INSTANCES {
            self.instances.remove(0);
        }
        self.instances.push(instance);
    }

    pub(crate) fn owner(&self) -> Option<&StageInstance> {
        self.instances.last()
    }

    /// Returns the number of the instance that wrote the checkpoint with the given next tick.
    pub(crate) fn instance_at(&self, next_tick: Option<u64>) -> u32 {
        let had_started = |instance: &&StageInstance| instance.restored_tick <= next_tick;
        self.instances.iter().rev().find(had_started).or(self.instances.first()).map_or(0, |instance| instance.number)
    }
}

/// Adds a stage's name and settings to an event.
pub(crate) fn with_stage(event: SystemEvent, stage: &StageConfig) -> SystemEvent {
    event.with_stage(&stage.stage, stage.set.iter().map(|(name, value)| (name.as_str(), *value)))
}
