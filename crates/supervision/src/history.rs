//! Events published on the topic `event` while the system runs: actions, observations and the owner
//! of each slot.
//!
//! - Input: decisions of [`Supervision`].
//! - Output: [`Action::PublishEvent`].
//! - Time: added by the caller.
//! - Failure: a text that is too long is truncated, and the event is marked.

use control::SwapReport;
use foreign::ForeignText;
use launch::{Service, StageConfig};
use messages::{EventKind, SystemEvent};
use swap::Resume;

use crate::{Action, Supervision};

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
    restored_tick: Option<u64>,
    /// Number of the instance that wrote the checkpoint of `restored_tick`.
    restored_from: u32,
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

    /// Returns the number of the instance that wrote the checkpoint of a tick.
    fn instance_at(&self, next_tick: Option<u64>) -> u32 {
        let had_started = |instance: &&StageInstance| instance.restored_tick <= next_tick;
        self.instances.iter().rev().find(had_started).or(self.instances.first()).map_or(0, |instance| instance.number)
    }
}

impl Supervision {
    pub(crate) fn publish_event(&mut self, event: SystemEvent) {
        self.actions.push(Action::PublishEvent(Box::new(event)));
    }

    /// Publishes an event about a process of a service.
    pub(crate) fn publish_service_event(&mut self, service: Service, incarnation: u32, event: SystemEvent) {
        self.publish_event(SystemEvent { service: service as u32, incarnation, ..event });
    }

    /// Publishes the first start or a restart of a service.
    pub(crate) fn publish_start(&mut self, service: Service, incarnation: u32) {
        let entry = self.table.entry(service);
        let (restarts, resume_tick) = (entry.restarts(), entry.resume_tick());
        let history = service.slot().and_then(|slot| self.swaps.history(slot));
        let numbers = history.and_then(|fillings| Some((fillings.owner()?.number, fillings.instance_at(resume_tick))));
        let (filling, adopted_filling) = numbers.unwrap_or((SystemEvent::NONE_U32, SystemEvent::NONE_U32));
        let kind = if restarts > 0 { EventKind::RESTARTED } else { EventKind::STARTED };
        let adopted_tick = resume_tick.unwrap_or(SystemEvent::NONE);
        let event = SystemEvent { filling, adopted_filling, adopted_tick, ..SystemEvent::new(kind) };
        let event = match service.slot() {
            Some(slot) => with_stage(event, self.config.launch.stage(slot)),
            None => event,
        };
        self.publish_service_event(service, incarnation, event);
    }

    /// Publishes an event about the owner or candidate of a slot.
    ///
    /// `instance` is `None` if the slot has no owner.
    pub(crate) fn publish_instance(
        &mut self,
        kind: EventKind,
        service: Service,
        incarnation: u32,
        epoch: u32,
        tick: u64,
        instance: Option<&StageInstance>,
    ) {
        let event = SystemEvent { epoch, tick, ..SystemEvent::new(kind) };
        let event = match instance {
            Some(instance) => {
                let StageInstance { number, stage, restored_tick, restored_from, predecessor_end } = instance;
                with_stage(event, stage).with_instance(
                    *number,
                    *restored_tick,
                    *restored_from,
                    predecessor_end.is_some(),
                )
            }
            None => event,
        };
        self.publish_service_event(service, incarnation, event);
    }

    /// Publishes the outcome of a swap request.
    pub(crate) fn publish_swap_report(&mut self, report: &SwapReport) {
        let kind = match report.outcome {
            swap::SwapOutcome::Committed => EventKind::SWAPPED,
            swap::SwapOutcome::Refused => EventKind::REFUSED,
            swap::SwapOutcome::Aborted => EventKind::ABORTED,
        };
        let tick = report.commit_tick.unwrap_or(SystemEvent::NONE);
        let event = SystemEvent { tick, ..SystemEvent::new(kind) }.with_stage(report.to.raw(), []);
        let event = event.with_reason(report.reason.as_ref().map_or("", ForeignText::raw));
        let service = Service::from_name(report.slot.raw()).map_or(SystemEvent::NONE_U32, |service| service as u32);
        self.publish_event(SystemEvent { service, ..event });
    }
}

/// Adds a stage's name and settings to an event.
pub(crate) fn with_stage(event: SystemEvent, stage: &StageConfig) -> SystemEvent {
    event.with_stage(&stage.stage, stage.set.iter().map(|(name, value)| (name.as_str(), *value)))
}
