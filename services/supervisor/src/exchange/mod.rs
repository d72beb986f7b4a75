//! Exchanging what fills a slot: the coordinators of the slots, and what they ask for.
//!
//! Input: requests, what the services say, deaths and births. Output: candidates that begin and end, decisions, answers. Time: the
//! clock, for deadlines. Failure: a request that cannot be met is answered with the reason, and the slot stays as it was.

mod desk;
mod wish;

use std::time::Instant;

use bus::{Bus, Publisher};
use launch::{Launch, Service, Stage, nearest};
use messages::{AccelPoint, AttitudeOutput, Control, FusedState, GyroStep, Health, ImuSample};
use runtime::{Orders, Role, service::FIRST_EPOCH};
use swap::{Action, Coordinator, Event, Limits, Outcome, Reason, Standing, State};

use desk::Desk;
pub use wish::{SwapReport, Wish};

use crate::{
    UpError,
    collector::Collector,
    crew::{self, Crew, Death, News},
    memory::{Memory, readers},
};

/// The slots of a system.
pub(crate) struct Exchange {
    slots: Vec<Slot>,
    control: Publisher<Control>,
    started: Instant,
    orders: Orders,
    requests: u64,
    /// Requests for slots whose last exchange is being cleared away.
    queued: Vec<(Service, Stage, swap::Request)>,
    desk: Desk,
}

struct Slot {
    service: Service,
    coordinator: Coordinator,
    candidate: Option<Stage>,
    ready: bool,
    /// What the life said that ended last.
    last_words: String,
}

impl Exchange {
    /// The slots, each owned by the stage that was started in it first.
    pub(crate) fn new(control: Publisher<Control>, orders: &Orders, crew: &Crew) -> Self {
        let margin_ticks = if orders.lockstep() { orders.window_ticks() } else { (orders.rate_hz * 0.05) as u64 };
        let margin_ticks = margin_ticks.max(8);
        let limits = Limits {
            ready_ms: 10_000,
            caught_up_ms: 5_000,
            shadow_ms: 100,
            commit_ms: 400 + (margin_ticks as f64 / orders.rate_hz * 1e3) as u64,
            restore_ms: 500,
            linger_ms: 1_000,
            end_ms: 400,
            lag_max_ticks: ((orders.rate_hz * 0.02) as u64).max(8),
            margin_ticks,
        };
        let slots =
            crew.posts().map(|(service, _)| service).filter(|service| orders.launch.slot(*service).is_some()).map(
                |service| Slot {
                    service,
                    coordinator: Coordinator::new(crew.post(service).incarnation(), FIRST_EPOCH, limits),
                    candidate: None,
                    ready: false,
                    last_words: String::new(),
                },
            );
        Self {
            slots: slots.collect(),
            control,
            started: Instant::now(),
            orders: orders.clone(),
            requests: 0,
            queued: Vec::new(),
            desk: Desk::default(),
        }
    }

    /// An exchange is under way.
    pub(crate) fn is_busy(&self) -> bool {
        self.desk.is_busy() || self.slots.iter().any(|slot| slot.coordinator.state() != State::Idle)
    }

    /// Takes a wish; the number under which it is answered.
    pub(crate) fn wish(&mut self, wish: Wish, collector: &mut Collector, crew: &mut Crew, memory: &mut Memory) -> u64 {
        self.requests += 1;
        let id = self.requests;
        let checked = self.checked(&wish);
        let until_ms = wish.limit_ms.map_or(u64::MAX, |limit_ms| self.now_ms().saturating_add(limit_ms));
        let Wish { slot, stage, shadow, expected_epoch, .. } = wish;
        let (service, from) = match checked {
            Ok((service, from)) => (service, from),
            Err((from, reason)) => {
                self.desk.refuse(id, slot, from, stage.stage, reason);
                return id;
            }
        };
        let epoch = self.slot(service).map_or(0, |slot| slot.coordinator.epoch());
        if let Some(expected) = expected_epoch.filter(|expected| *expected != epoch) {
            let reason =
                format!("the last decision about `{slot}` is number {epoch}, not {expected}; ask how it is, and again");
            self.desk.refuse(id, slot, from, stage.stage, reason);
            return id;
        }
        self.desk.open(id, service, from, stage.stage.clone(), collector);
        let request = swap::Request { id, stage: stage.stage.clone(), shadow_only: shadow, until_ms };
        let Some(slot) = self.slot(service) else { return id };
        if matches!(slot.coordinator.state(), State::Committed { .. } | State::Retiring { .. } | State::Aborting)
            && !self.queued.iter().any(|(queued, ..)| *queued == service)
        {
            self.queued.push((service, stage, request));
            return id;
        }
        self.request(service, stage, request, crew, memory);
        id
    }

    /// The slot that a wish is for and what fills it, or what fills it and why the wish cannot be met.
    pub(crate) fn checked(&self, wish: &Wish) -> Result<(Service, String), (String, String)> {
        let here = Service::named(&wish.slot).filter(|service| self.slots.iter().any(|slot| slot.service == *service));
        let Some((service, from)) = here.and_then(|service| Some((service, self.orders.launch.slot(service)?))) else {
            let slots: Vec<_> = self.slots.iter().map(|slot| slot.service.name()).collect();
            let meant = nearest(&wish.slot, &slots).map_or(String::new(), |slot| format!("; did you mean `{slot}`?"));
            let reason = format!("there is no slot `{}` here{meant}; there are {}", wish.slot, slots.join(", "));
            return Err((String::new(), reason));
        };
        let from = from.stage.clone();
        match check(&self.orders, service, &wish.stage) {
            Ok(()) => Ok((service, from)),
            Err(reason) => Err((from, reason)),
        }
    }

    /// Asks the slot's coordinator. Who asks for the stage that already runs beside it asks for its promotion.
    fn request(
        &mut self,
        service: Service,
        stage: Stage,
        request: swap::Request,
        crew: &mut Crew,
        memory: &mut Memory,
    ) {
        let Some(slot) = self.slot(service) else { return };
        let promotes = slot.candidate.as_ref() == Some(&stage) && !request.shadow_only && slot.shadows();
        if slot.coordinator.state() == State::Idle {
            slot.candidate = Some(stage);
        }
        let until_ms = request.until_ms;
        let event = if promotes { Event::Promote { until_ms } } else { Event::Request(request) };
        self.tell(service, event, crew, memory);
    }

    /// How the services are, and the last decision about each slot.
    pub(crate) fn ps(&self, crew: &Crew) -> Vec<crew::Standing> {
        let mut all = crew.ps();
        for slot in &self.slots {
            let of_slot = all.iter_mut().filter(|standing| standing.service == slot.service.name());
            of_slot.for_each(|standing| standing.epoch = slot.coordinator.epoch());
        }
        all
    }

    /// Ends a shadow.
    pub(crate) fn cancel(&mut self, service: Service, crew: &mut Crew, memory: &mut Memory) {
        self.tell(service, Event::Cancel, crew, memory);
    }

    /// The answer to a request, once.
    pub(crate) fn take_answer(&mut self, id: u64) -> Option<SwapReport> {
        self.desk.take_answer(id)
    }

    /// Whether a checkpoint may be kept.
    pub(crate) fn admits(&mut self, service: u32, incarnation: u32, next_tick: u64) -> bool {
        let slot = self.slots.iter_mut().find(|slot| slot.service as u32 == service);
        slot.is_none_or(|slot| slot.coordinator.admits(incarnation, next_tick))
    }

    /// Takes what has happened, looks at the deadlines, and does what is to be done.
    pub(crate) fn go_on(
        &mut self,
        bus: &Bus,
        news: &mut News,
        collector: &mut Collector,
        crew: &mut Crew,
        memory: &mut Memory,
    ) -> Result<(), UpError> {
        self.control.greet()?;
        for service in self.slots.iter().map(|slot| slot.service).collect::<Vec<_>>() {
            let next_tick = published_tick(bus, service);
            self.tell(service, Event::Published { next_tick }, crew, memory);
        }
        for Death { service, incarnation, said } in &news.deaths {
            if let Some(slot) = self.slot(*service) {
                slot.last_words.clone_from(said);
            }
            self.tell(*service, Event::Died { incarnation: *incarnation }, crew, memory);
        }
        crew.revive(memory, news)?;
        for (service, incarnation) in &news.births {
            self.tell(*service, Event::Restarted { incarnation: *incarnation }, crew, memory);
        }
        for service in &news.away {
            self.tell(*service, Event::Vacated, crew, memory);
        }
        let idle = |slot: &Slot| slot.coordinator.state() == State::Idle;
        let free: Vec<_> = self.slots.iter().filter(|slot| idle(slot)).map(|slot| slot.service).collect();
        while let Some(place) = self.queued.iter().position(|(service, ..)| free.contains(service)) {
            let (service, stage, request) = self.queued.swap_remove(place);
            self.request(service, stage, request, crew, memory);
        }
        // Where the samples are on another host, what was made of them tells it.
        let newest_tick = bus.next_tick::<ImuSample>().max(bus.next_tick::<GyroStep>()).saturating_sub(1);
        for service in self.slots.iter().map(|slot| slot.service).collect::<Vec<_>>() {
            self.tell(service, Event::NewestInput { tick: newest_tick }, crew, memory);
            let kept =
                readers(service).iter().filter_map(|reader| memory.resume_tick(*reader, &self.orders.launch)).min();
            let next_tick = if readers(service).is_empty() { collector.next_tick() } else { kept.unwrap_or(0) };
            self.tell(service, Event::ReadersKeep { next_tick }, crew, memory);
            let (active, candidate) =
                (crew.post(service).heard().copied(), crew.post(service).candidate_heard().copied());
            // What it has published says more about how far it is than what it said last, but for what the candidate may have published.
            let published = Some(published_tick(bus, service))
                .filter(|tick| self.handing_over_at(service).is_none_or(|from_tick| *tick <= from_tick));
            for health in active.iter() {
                self.tell(service, standing(health, published.unwrap_or(0)), crew, memory);
            }
            for health in candidate.iter() {
                self.tell(service, standing(health, 0), crew, memory);
            }
            if let (Some(health), Some(slot)) = (candidate, self.slot(service))
                && !slot.ready
            {
                slot.ready = true;
                self.tell(service, Event::Ready { incarnation: health.incarnation }, crew, memory);
            }
        }
        let now_ms = self.now_ms();
        self.desk.finish(now_ms, collector);
        Ok(())
    }

    /// Nobody owns the slot any more: its service has failed.
    pub(crate) fn leave_empty(&mut self, bus: &Bus, service: Service, crew: &mut Crew, memory: &mut Memory) {
        self.tell(service, Event::Published { next_tick: published_tick(bus, service) }, crew, memory);
        self.tell(service, Event::Vacated, crew, memory);
    }

    /// The tick at which a slot changes hands, between the decision and its confirmation.
    fn handing_over_at(&mut self, service: Service) -> Option<u64> {
        match self.slot(service)?.coordinator.state() {
            State::Armed { from_tick } => Some(from_tick),
            _ => None,
        }
    }

    fn now_ms(&self) -> u64 {
        self.started.elapsed().as_millis() as u64
    }

    fn slot(&mut self, service: Service) -> Option<&mut Slot> {
        self.slots.iter_mut().find(|slot| slot.service == service)
    }

    fn tell(&mut self, service: Service, event: Event, crew: &mut Crew, memory: &mut Memory) {
        let now_ms = self.now_ms();
        let mut events = vec![event];
        // Whatever is asked for is answered by one event at most, so this ends.
        while let Some(event) = events.pop() {
            let Some(slot) = self.slots.iter_mut().find(|slot| slot.service == service) else { return };
            for action in slot.coordinator.handle(now_ms, event) {
                match action {
                    action @ (Action::SpawnCandidate { epoch, .. } | Action::SpawnOwner { epoch, .. }) => {
                        slot.ready = false;
                        memory.forget_candidate(service);
                        let stage = slot.candidate.clone().unwrap_or_else(|| unreachable!("a request names a stage"));
                        let (role, resume) = match action {
                            Action::SpawnOwner { from_tick, .. } => {
                                (Role::Owner { from_tick }, memory.resume(service, &self.orders.launch))
                            }
                            _ => (Role::Candidate, memory.newest(service)),
                        };
                        let begun = crew.begin_candidate(service, stage, epoch, role, resume);
                        events.push(match begun {
                            Ok(incarnation) => Event::Spawned { incarnation },
                            Err(error) => Event::SpawnFailed { cause: error.to_string() },
                        });
                    }
                    Action::PublishControl(swap::Control { epoch, owner, from_tick }) => {
                        let decision = Control { from_tick, epoch, service: service as u32, owner, reserved: 0 };
                        crew.hasten_candidate(service);
                        // A decision that nobody hears is not confirmed, and taken back.
                        let _ = self.control.send(&decision);
                    }
                    Action::EndCandidate { incarnation } | Action::RetireOld { incarnation } => {
                        crew.dismiss(service, incarnation);
                    }
                    Action::RestartActive { epoch, from_tick } => {
                        crew.under(service, epoch, from_tick);
                        crew.begin_anew(service);
                    }
                    Action::Answer(report) => {
                        if report.outcome == Outcome::Committed
                            && let Some(stage) = slot.candidate.take()
                        {
                            crew.promote(service, stage.clone());
                            memory.promote(service);
                            if let Some(slot) = self.orders.launch.slot_mut(service) {
                                *slot = stage;
                            }
                        }
                        let busy = matches!(report.reason, Some(Reason::Busy { .. }));
                        if report.outcome != Outcome::Committed && !busy {
                            slot.candidate = None;
                        }
                        self.desk.settle(service, &report, &slot.last_words, now_ms);
                    }
                }
            }
        }
    }
}

impl Slot {
    fn shadows(&self) -> bool {
        matches!(self.coordinator.state(), State::Starting | State::CatchingUp | State::Shadowing)
    }
}

/// What a service said, as a coordinator takes it.
fn standing(health: &Health, published_tick: u64) -> Event {
    let standing = Standing {
        next_tick: health.next_tick.max(published_tick),
        decided_epoch: health.epoch,
        missed: health.missed != 0,
        published_from: Some(health.published_from).filter(|tick| *tick != u64::MAX),
    };
    Event::Health { incarnation: health.incarnation, standing, flawed: health.flawed > 0 }
}

/// The tick after the newest one that a slot has published.
pub(crate) fn published_tick(bus: &Bus, service: Service) -> u64 {
    match service {
        Service::Ingest => bus.next_tick::<ImuSample>(),
        Service::Gyro => bus.next_tick::<GyroStep>(),
        Service::Accel => bus.next_tick::<AccelPoint>(),
        Service::Fuser => bus.next_tick::<FusedState>(),
        Service::Course => bus.next_tick::<AttitudeOutput>(),
        Service::Gateway => 0,
    }
}

/// What is wrong with a stage for a slot, for people.
fn check(orders: &Orders, service: Service, stage: &Stage) -> Result<(), String> {
    orders.launch.may_fill(service, &stage.stage).map_err(|error| error.to_string())?;
    let mut launch: Launch = orders.launch.clone();
    if let Some(slot) = launch.slot_mut(service) {
        slot.clone_from(stage);
    }
    // A program of the user's says itself what is wrong with its settings.
    if launch.program(service).is_some() {
        return Ok(());
    }
    let orders = Orders { launch, ..orders.clone() };
    let checked = match service {
        Service::Ingest | Service::Gateway => return Ok(()),
        Service::Gyro => gyro::slot(&orders).map(|_| ()),
        Service::Accel => accel::slot(&orders).map(|_| ()),
        Service::Fuser => fuser::slot(&orders).map(|_| ()),
        Service::Course => course::slot(&orders).map(|_| ()),
    };
    checked.map_err(|error| error.to_string())
}
