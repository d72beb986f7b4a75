//! Runs a slot in one process, one stage after another.
//!
//! Input: the number of each tick, followed by the slot's messages for that tick.
//!
//! Output: the messages that the owner of the slot publishes.
//!
//! Time: ticks.
//!
//! Failure: a stage that cannot restore the state of its predecessor ends the run.

use std::collections::VecDeque;

use launch::Service;
use messages::Control;
use runtime::{
    Role, RuntimeError, ServiceConfig, SlotProcessor,
    service_config::{FIRST_EPOCH, Resume},
    slot_service::SlotService,
};

use crate::schedule::{OwnerChange, Schedule, SlotSchedule, StageActivation};

/// Slot with one stage or a sequence of stages.
pub(crate) enum SlotRunner<S: SlotProcessor> {
    /// Slot that keeps its stage.
    Fixed(S),
    /// Slot with the stage changes of a recorded flight.
    Replayed(Box<ReplayedSlot<S>>),
}

/// Slot with changing stages. Each stage runs as a service, as it does on the bus.
pub(crate) struct ReplayedSlot<S: SlotProcessor> {
    build: fn(&ServiceConfig) -> Result<S, RuntimeError>,
    config: ServiceConfig,
    schedule: SlotSchedule,
    /// Running services, by instance number.
    services: Vec<(u32, SlotService<S>)>,
    /// Stages still to be started, by instance number.
    pending_activations: Vec<(u32, StageActivation)>,
    pending_changes: VecDeque<OwnerChange>,
    /// Epoch of the last decision.
    epoch: u32,
}

impl<S: SlotProcessor<Input: Clone>> SlotRunner<S> {
    pub(crate) fn new(
        build: fn(&ServiceConfig) -> Result<S, RuntimeError>,
        config: &ServiceConfig,
        schedule: &Schedule,
    ) -> Result<Self, RuntimeError> {
        let first = build(config)?;
        let Some(schedule) = schedule.slot(S::SLOT) else { return Ok(Self::Fixed(first)) };
        let role = Role::Owner { from_tick: 0 };
        let config = ServiceConfig { incarnation: 0, epoch: FIRST_EPOCH, role, resume: None, ..config.clone() };
        let (first, _) = SlotService::new(first, &config, 0, 0);
        Ok(Self::Replayed(Box::new(ReplayedSlot {
            build,
            services: vec![(0, first)],
            pending_activations: schedule
                .activations
                .iter()
                .map(|(instance, stage)| (*instance, stage.clone()))
                .collect(),
            pending_changes: schedule.owner_changes.iter().copied().collect(),
            schedule: schedule.clone(),
            config,
            epoch: FIRST_EPOCH,
        })))
    }

    /// Applies all stage activations and owner changes up to `tick`. Must be called before any
    /// input of `tick` or a later tick is offered.
    pub(crate) fn advance_to(&mut self, tick: u64, publish: &mut dyn FnMut(S::Output)) -> Result<(), RuntimeError> {
        match self {
            Self::Fixed(_) => Ok(()),
            Self::Replayed(replayed) => replayed.advance_to(tick, publish),
        }
    }

    pub(crate) fn offer(&mut self, input: S::Input, publish: &mut dyn FnMut(S::Output)) {
        match self {
            Self::Fixed(slot) => slot.offer(input, publish),
            Self::Replayed(replayed) => {
                for (_, service) in &mut replayed.services {
                    service.offer(input.clone(), &mut |_| {}, publish);
                }
            }
        }
    }

    /// Returns the cause of the failure if the owner of the slot has failed.
    pub(crate) fn failure(&self) -> Option<String> {
        match self {
            Self::Fixed(slot) => slot.failure(),
            // A failure of a stage that does not own the slot does not affect the output.
            Self::Replayed(replayed) => {
                let owner = replayed.services.iter().find(|(_, service)| service.owns_next_tick());
                owner.and_then(|(_, service)| service.failure())
            }
        }
    }
}

impl<S: SlotProcessor<Input: Clone>> ReplayedSlot<S> {
    fn advance_to(&mut self, tick: u64, publish: &mut dyn FnMut(S::Output)) -> Result<(), RuntimeError> {
        let is_due = |activation: &StageActivation| activation.adopted_tick.unwrap_or(0) <= tick;
        while let Some(index) = self.pending_activations.iter().position(|(_, activation)| is_due(activation)) {
            let (instance, activation) = self.pending_activations.swap_remove(index);
            self.activate(instance, &activation)?;
        }
        while let Some(change) = self.pending_changes.pop_front_if(|change| change.from_tick <= tick) {
            self.epoch += 1;
            let (from_tick, epoch, owner) = (change.from_tick, self.epoch, change.instance);
            let control = Control { from_tick, epoch, service: Service::from(S::SLOT) as u32, owner, reserved: 0 };
            for (_, service) in &mut self.services {
                service.apply_decision(&control, publish);
            }
        }
        let Self { services, schedule, .. } = self;
        services.retain(|(instance, _)| schedule.needed_until(*instance) > tick);
        Ok(())
    }

    /// Starts a stage as its service did on the bus, either from a checkpoint of another stage or
    /// without one.
    fn activate(&mut self, instance: u32, activation: &StageActivation) -> Result<(), RuntimeError> {
        let Self { services, config, .. } = self;
        let stage_failed = |cause: String| RuntimeError::StageFailed { slot: S::SLOT, cause };
        let resume = match activation.adopted_tick {
            Some(tick) => {
                let source = services.iter_mut().find(|(instance, _)| *instance == activation.source_instance);
                let (_, source) = source.ok_or_else(|| {
                    stage_failed(format!("the stage that handed over its state before tick {tick} is not running"))
                })?;
                Resume::Checkpoint(source.state())
            }
            None => Resume::Fresh,
        };
        let mut changes = self.schedule.owner_changes.iter();
        let from_tick = changes.find(|change| change.instance == instance).map_or(u64::MAX, |change| change.from_tick);
        let role = if activation.replaces_ended { Role::Owner { from_tick } } else { Role::Candidate };
        let mut config =
            ServiceConfig { incarnation: instance, role, epoch: self.epoch, resume: Some(resume), ..config.clone() };
        config.launch.stage_mut(S::SLOT).clone_from(&activation.stage);
        let (service, resume_error) = SlotService::new((self.build)(&config)?, &config, 0, from_tick);
        if let Some(error) = resume_error {
            let stage = &activation.stage.stage;
            return Err(stage_failed(format!("`{stage}` cannot restore the state of its predecessor: {error}")));
        }
        self.services.push((instance, service));
        Ok(())
    }
}
