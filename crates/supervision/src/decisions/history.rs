//! Events published on the topic `event` while the system runs: actions, observations and the owner
//! of each slot.
//!
//! - Input: decisions of [`Supervision`].
//! - Output: [`Action::PublishEvent`].
//! - Time: the caller adds the time of each event.
//! - Failure: a text that is too long is truncated, and the event is marked.

use control::SwapReport;
use foreign::ForeignText;
use launch::Service;
use messages::{EventKind, SystemEvent};

use crate::{
    Action, Supervision,
    state::stage_history::{StageInstance, with_stage},
};

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
        let (instance, adopted_instance) = numbers.unwrap_or((SystemEvent::NONE_U32, SystemEvent::NONE_U32));
        let kind = if restarts > 0 { EventKind::RESTARTED } else { EventKind::STARTED };
        let adopted_tick = resume_tick.unwrap_or(SystemEvent::NONE);
        let event = SystemEvent { instance, adopted_instance, adopted_tick, ..SystemEvent::new(kind) };
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
