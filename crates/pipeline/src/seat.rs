//! A slot in one process, with the stages that it has one after the other.
//!
//! Input: messages of the slot, and before each tick its number. Output: what whoever owns the slot publishes. Time: ticks. Failure: a stage that
//! does not go on from the state that it is to take over ends the path.

use std::collections::VecDeque;

use launch::Service;
use messages::Control;
use runtime::{
    Role, RuntimeError, ServiceConfig, Slot,
    service_config::{FIRST_EPOCH, Resume},
    slot_service::SlotService,
};

use crate::schedule::{Filling, Schedule, SlotSchedule, Turn};

/// A slot.
pub(crate) enum Seat<S: Slot> {
    /// With one stage.
    Alone(S),
    /// With a schedule.
    Scheduled(Box<Scheduled<S>>),
}

/// A slot whose stages change: each is a service as on the bus.
pub(crate) struct Scheduled<S: Slot> {
    slot: Service,
    make: fn(&ServiceConfig) -> Result<S, RuntimeError>,
    config: ServiceConfig,
    schedule: SlotSchedule,
    /// Those at work, by their numbers.
    services: Vec<(u32, SlotService<S>)>,
    /// Those that are still to begin, and turns that are still to come.
    beginning: Vec<(u32, Filling)>,
    turns: VecDeque<Turn>,
    /// The last decision.
    epoch: u32,
}

impl<S: Slot<Input: Clone>> Seat<S> {
    pub(crate) fn new(
        slot: Service,
        make: fn(&ServiceConfig) -> Result<S, RuntimeError>,
        config: &ServiceConfig,
        schedule: &Schedule,
    ) -> Result<Self, RuntimeError> {
        let first = make(config)?;
        let Some(schedule) = schedule.of(slot) else { return Ok(Self::Alone(first)) };
        let role = Role::Owner { from_tick: 0 };
        let config = ServiceConfig { incarnation: 0, epoch: FIRST_EPOCH, role, resume: None, ..config.clone() };
        let (first, _) = SlotService::new(first, slot, &config, 0, 0);
        Ok(Self::Scheduled(Box::new(Scheduled {
            slot,
            make,
            services: vec![(0, first)],
            beginning: schedule.fillings.iter().map(|(number, filling)| (*number, filling.clone())).collect(),
            turns: schedule.turns.iter().copied().collect(),
            schedule: schedule.clone(),
            config,
            epoch: FIRST_EPOCH,
        })))
    }

    /// Nothing of this tick or a later one has been offered.
    pub(crate) fn before(&mut self, tick: u64, publish: &mut dyn FnMut(S::Output)) -> Result<(), RuntimeError> {
        match self {
            Self::Alone(_) => Ok(()),
            Self::Scheduled(scheduled) => scheduled.before(tick, publish),
        }
    }

    pub(crate) fn offer(&mut self, input: S::Input, publish: &mut dyn FnMut(S::Output)) {
        match self {
            Self::Alone(slot) => slot.offer(input, publish),
            Self::Scheduled(scheduled) => {
                for (_, service) in &mut scheduled.services {
                    service.offer(input.clone(), &mut |_| {}, publish);
                }
            }
        }
    }

    /// Why nothing more comes of it.
    pub(crate) fn failure(&self) -> Option<String> {
        match self {
            Self::Alone(slot) => slot.failure(),
            // One that waits for its turn, or has had it, is nobody's loss.
            Self::Scheduled(scheduled) => {
                let owner = scheduled.services.iter().find(|(_, service)| service.owns_next_tick());
                owner.and_then(|(_, service)| service.failure())
            }
        }
    }
}

impl<S: Slot<Input: Clone>> Scheduled<S> {
    fn before(&mut self, tick: u64, publish: &mut dyn FnMut(S::Output)) -> Result<(), RuntimeError> {
        let begins = |filling: &Filling| filling.adopted_tick.unwrap_or(0) <= tick;
        while let Some(place) = self.beginning.iter().position(|(_, filling)| begins(filling)) {
            let (number, filling) = self.beginning.swap_remove(place);
            self.begin(number, &filling)?;
        }
        while let Some(turn) = self.turns.pop_front_if(|turn| turn.from_tick <= tick) {
            self.epoch += 1;
            let (from_tick, epoch, owner) = (turn.from_tick, self.epoch, turn.filling);
            let control = Control { from_tick, epoch, service: self.slot as u32, owner, reserved: 0 };
            for (_, service) in &mut self.services {
                service.apply_decision(&control, publish);
            }
        }
        let Self { services, schedule, .. } = self;
        services.retain(|(number, _)| schedule.needed_until(*number) > tick);
        Ok(())
    }

    /// A stage begins as its service did on the bus: from the state of another, or anew.
    fn begin(&mut self, number: u32, filling: &Filling) -> Result<(), RuntimeError> {
        let Self { slot, services, config, .. } = self;
        let failed = |why: String| RuntimeError::StageFailed { slot: *slot, cause: why };
        let resume = match filling.adopted_tick {
            Some(tick) => {
                let former = services.iter_mut().find(|(number, _)| *number == filling.adopted_filling);
                let former = former
                    .ok_or_else(|| failed(format!("nothing is there to hand on the state before tick {tick}")))?;
                Resume::Checkpoint(Box::new((&former.1.state()).into()))
            }
            None => Resume::Fresh,
        };
        let turn =
            self.schedule.turns.iter().find(|turn| turn.filling == number).map_or(u64::MAX, |turn| turn.from_tick);
        let role = if filling.alone { Role::Owner { from_tick: turn } } else { Role::Candidate };
        let mut config =
            ServiceConfig { incarnation: number, role, epoch: self.epoch, resume: Some(resume), ..config.clone() };
        if let Some(stage) = config.launch.stage_mut(*slot) {
            stage.clone_from(&filling.stage);
        }
        let (service, refused) = SlotService::new((self.make)(&config)?, *slot, &config, 0, turn);
        if let Some(error) = refused {
            return Err(failed(format!("`{}` does not go on from the state of another: {error}", filling.stage.stage)));
        }
        self.services.push((number, service));
        Ok(())
    }
}
