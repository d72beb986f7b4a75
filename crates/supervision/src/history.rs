//! What is told of the system while it runs, on the topic `event`: what was done, what was seen, and which stage has a slot from which tick on.
//!
//! Input: what is decided. Output: [`Action::Tell`]. Time: the shell stamps it. Failure: a text that is too long is cut, and the event says so.

use launch::{Service, Stage};
use messages::{EventKind, SystemEvent};

use crate::{Action, Resume, Supervision, SwapReport};

/// Former stages of a slot that are remembered.
const FORMER_MAX: usize = 64;

/// A stage that has, or is to have, a slot.
#[derive(Debug, Clone)]
pub(crate) struct Filling {
    /// Its number: 0 is the launch file's, each candidate counts one on, and a restart changes nothing.
    pub(crate) number: u32,
    pub(crate) stage: Stage,
    /// The tick before which the state was that it began with; none where it began anew.
    adopted_tick: Option<u64>,
    /// Of which one that was.
    adopted_from: u32,
    /// It began in the place of one that had ended, which had published all before this tick.
    pub(crate) replaces_until: Option<u64>,
}

/// The stages that a slot has had, its owner last.
#[derive(Debug, Clone)]
pub(crate) struct Fillings {
    all: Vec<Filling>,
    count: u32,
}

impl Fillings {
    /// A slot with the launch file's stage.
    pub(crate) fn new(stage: Stage) -> Self {
        let first = Filling { number: 0, stage, adopted_tick: Some(0), adopted_from: 0, replaces_until: None };
        Self { all: vec![first], count: 1 }
    }

    /// A stage that is to have the slot.
    pub(crate) fn next(&mut self, stage: Stage, resume: &Resume, replaces_until: Option<u64>) -> Filling {
        let number = self.count;
        self.count += 1;
        let adopted_tick = next_tick(resume);
        Filling { number, stage, adopted_tick, adopted_from: self.at(adopted_tick), replaces_until }
    }

    /// It has the slot.
    pub(crate) fn enter(&mut self, filling: Filling) {
        if self.all.len() == FORMER_MAX {
            self.all.remove(0);
        }
        self.all.push(filling);
    }

    /// The owner.
    pub(crate) fn owner(&self) -> Option<&Filling> {
        self.all.last()
    }

    /// The number of the one that had computed this state.
    fn at(&self, next_tick: Option<u64>) -> u32 {
        let had_begun = |filling: &&Filling| filling.adopted_tick <= next_tick;
        self.all.iter().rev().find(had_begun).or(self.all.first()).map_or(0, |filling| filling.number)
    }
}

/// The tick that a service takes next that goes on from there.
fn next_tick(resume: &Resume) -> Option<u64> {
    match resume {
        Resume::Fresh => None,
        Resume::Checkpoint(checkpoint) => Some(checkpoint.next_tick),
        Resume::Source { next_tick, .. } => Some(*next_tick),
    }
}

impl Supervision {
    /// Tells whoever listens.
    pub(crate) fn tell(&mut self, event: SystemEvent) {
        self.actions.push(Action::Tell(Box::new(event)));
    }

    /// A process of a service has something to be told of.
    pub(crate) fn tell_of(&mut self, service: Service, incarnation: u32, event: SystemEvent) {
        self.tell(SystemEvent { service: service as u32, incarnation, ..event });
    }

    /// A service has started, for the first time or again.
    pub(crate) fn tell_start(&mut self, service: Service, incarnation: u32) {
        let entry = self.table.entry(service);
        let (restarts, resumes_at) = (entry.restarts(), entry.resumes_at());
        let fillings = self.swaps.fillings(service);
        let numbers = fillings.and_then(|fillings| Some((fillings.owner()?.number, fillings.at(resumes_at))));
        let (filling, adopted_filling) = numbers.unwrap_or((SystemEvent::NOBODY, SystemEvent::NOBODY));
        let kind = if restarts > 0 { EventKind::RESTARTED } else { EventKind::STARTED };
        let adopted_tick = resumes_at.unwrap_or(SystemEvent::NONE);
        let event = SystemEvent { filling, adopted_filling, adopted_tick, ..SystemEvent::new(kind) };
        let event = match self.config.launch.slot(service) {
            Some(stage) => with_stage(event, stage),
            None => event,
        };
        self.tell_of(service, incarnation, event);
    }

    /// What is told of a stage that has, or is to have, a slot; without one, of nobody.
    pub(crate) fn tell_filling(
        &mut self,
        kind: EventKind,
        service: Service,
        incarnation: u32,
        epoch: u32,
        tick: u64,
        filling: Option<&Filling>,
    ) {
        let event = SystemEvent { epoch, tick, ..SystemEvent::new(kind) };
        let event = match filling {
            Some(filling) => {
                let Filling { number, stage, adopted_tick, adopted_from, replaces_until } = filling;
                with_stage(event, stage).begun(*number, *adopted_tick, *adopted_from, replaces_until.is_some())
            }
            None => event,
        };
        self.tell_of(service, incarnation, event);
    }

    /// How a request went.
    pub(crate) fn tell_report(&mut self, report: &SwapReport) {
        let kind = match report.outcome {
            swap::Outcome::Committed => EventKind::SWAPPED,
            swap::Outcome::Refused => EventKind::REFUSED,
            swap::Outcome::Aborted => EventKind::ABORTED,
        };
        let tick = report.commit_tick.unwrap_or(SystemEvent::NONE);
        let event = SystemEvent { tick, ..SystemEvent::new(kind) }.with_stage(&report.to, []);
        let event = event.with_why(report.reason.as_deref().unwrap_or_default());
        let service = Service::named(&report.slot).map_or(SystemEvent::NOBODY, |service| service as u32);
        self.tell(SystemEvent { service, ..event });
    }
}

/// With a stage's name and settings.
pub(crate) fn with_stage(event: SystemEvent, stage: &Stage) -> SystemEvent {
    event.with_stage(&stage.stage, stage.set.iter().map(|(name, value)| (name.as_str(), *value)))
}
