//! Who fills the slots: the coordinator of each, and what it is told and asks for.

use launch::{Launch, Service, Stage, nearest};
use messages::{EventKind, Health, SystemEvent};
use swap::{Coordinator, FIRST_EPOCH, Limits, Outcome, OwnershipStatus, Reason, Role, State};

use crate::{
    Action, Config, OutputProgress, Reply, Resume, Spawn, Supervision, SwapReport, SwapRequest,
    history::{Filling, Fillings, with_stage},
    pending_swaps::{Asker, Pending},
    process::Process,
};

/// How far ahead of the newest sample a slot changes hands, s: a decision that reaches the stage later than that is taken back.
const MARGIN_S: f64 = 0.05;
/// How often a slot is to change hands for one request, each time with twice the margin: on a machine that stands still for a moment the
/// decision comes too late.
const ATTEMPTS_MAX: u32 = 3;

/// The slots of a system.
#[derive(Debug, Default)]
pub(crate) struct Swaps {
    slots: Vec<Slot>,
    requests: u64,
    /// Requests for slots whose last swap is being cleared away.
    queued: Vec<(Service, Stage, swap::Request)>,
}

#[derive(Debug)]
struct Slot {
    service: Service,
    coordinator: Coordinator,
    candidate: Option<Stage>,
    fillings: Fillings,
    /// The stage that is to have the slot.
    beside: Option<Filling>,
    /// One that began in the place of an owner that had ended may have published.
    replaced: bool,
    attempt: Attempt,
    ready: bool,
    /// What the process said that ended last.
    last_words: String,
}

/// A request that has begun, and how often.
#[derive(Debug, Clone, Copy, Default)]
struct Attempt {
    id: u64,
    until_ms: u64,
    times: u32,
}

impl Attempt {
    fn begin(&mut self, request: &swap::Request) {
        let times = if self.id == request.id { self.times + 1 } else { 1 };
        *self = Self { id: request.id, until_ms: request.until_ms, times };
    }
}

impl Swaps {
    /// Whether a checkpoint may be kept.
    pub(crate) fn admits(&mut self, service: u32, incarnation: u32, next_tick: u64) -> bool {
        let slot = self.slots.iter_mut().find(|slot| slot.service as u32 == service);
        slot.is_none_or(|slot| slot.coordinator.admits(incarnation, next_tick))
    }

    /// The last decision about a slot.
    pub(crate) fn epoch(&self, service: Service) -> Option<u32> {
        Some(self.slot(service)?.coordinator.epoch())
    }

    pub(crate) fn note_last_words(&mut self, service: Service, stderr: &str) {
        if let Some(slot) = self.slot_mut(service) {
            stderr.clone_into(&mut slot.last_words);
        }
    }

    /// The stage that is to have a slot.
    pub(crate) fn beside(&self, service: Service) -> Option<&Filling> {
        self.slot(service)?.beside.as_ref()
    }

    /// The stages that a slot has had.
    pub(crate) fn fillings(&self, service: Service) -> Option<&Fillings> {
        Some(&self.slot(service)?.fillings)
    }

    fn is_busy(&self) -> bool {
        self.slots.iter().any(|slot| slot.coordinator.state() != State::Idle)
    }

    fn services(&self) -> Vec<Service> {
        self.slots.iter().map(|slot| slot.service).collect()
    }

    fn slot(&self, service: Service) -> Option<&Slot> {
        self.slots.iter().find(|slot| slot.service == service)
    }

    fn slot_mut(&mut self, service: Service) -> Option<&mut Slot> {
        self.slots.iter_mut().find(|slot| slot.service == service)
    }
}

impl Supervision {
    /// Each slot belongs to the process that was started for it last.
    pub(crate) fn fill_slots(&mut self) {
        let limits = limits(&self.config);
        let stages =
            self.entries().filter_map(|(service, entry)| Some((service, entry, self.config.launch.slot(service)?)));
        let slots = stages.map(|(service, entry, stage)| Slot {
            service,
            coordinator: Coordinator::new(entry.incarnation(), FIRST_EPOCH, limits),
            candidate: None,
            fillings: self.swaps.fillings(service).cloned().unwrap_or_else(|| Fillings::new(stage.clone())),
            beside: None,
            replaced: false,
            attempt: Attempt::default(),
            ready: false,
            last_words: String::new(),
        });
        self.swaps = Swaps { slots: slots.collect(), requests: self.swaps.requests, queued: Vec::new() };
    }

    /// A swap is under way.
    pub(crate) fn is_swapping(&self) -> bool {
        self.pending.is_busy() || self.swaps.is_busy()
    }

    pub(crate) fn on_published(&mut self, service: Service, next_tick: u64) {
        let published = &mut self.published[service as usize];
        *published = next_tick.max(*published);
        let next_tick = *published;
        self.notify_slot(service, swap::Event::Published { next_tick });
    }

    pub(crate) fn on_output(&mut self, output: OutputProgress) {
        let before = std::mem::replace(&mut self.output, output);
        let news = [
            (EventKind::LOST, output.lost.saturating_sub(before.lost)),
            (EventKind::NOT_TAKEN, output.not_taken.saturating_sub(before.not_taken)),
        ];
        for (kind, ticks) in news.into_iter().filter(|(_, ticks)| *ticks > 0) {
            self.tell(SystemEvent { tick: output.next_tick, ticks, ..SystemEvent::new(kind) });
        }
        self.checkpoints.on_output(output.next_tick);
        self.pending.note_gap(output.gap_ns);
    }

    pub(crate) fn on_swap_request(&mut self, caller: u64, request: SwapRequest) {
        if self.checked(&request).is_ok() {
            self.yield_watch(&request.slot);
        }
        let slot = Service::named(&request.slot).filter(|_| request.shadow);
        self.request_swap(request, Asker::Caller { caller, shadow: slot });
    }

    /// Whoever asked for a shadow and is gone does not want it any more.
    pub(crate) fn on_caller_gone(&mut self, caller: u64) {
        if let Some(slot) = self.pending.forget_caller(caller) {
            self.notify_slot(slot, swap::Event::Cancel);
        }
    }

    /// Takes a request; the number under which it is answered.
    pub(crate) fn request_swap(&mut self, request: SwapRequest, asker: Asker) -> u64 {
        self.swaps.requests += 1;
        let id = self.swaps.requests;
        let checked = self.checked(&request);
        let kind = if request.shadow { EventKind::SHADOW_ASKED } else { EventKind::SWAP_ASKED };
        let place = Service::named(&request.slot).map_or(SystemEvent::NOBODY, |service| service as u32);
        self.tell(SystemEvent { service: place, ..with_stage(SystemEvent::new(kind), &request.stage) });
        let until_ms = request.limit_ms.map_or(u64::MAX, |limit_ms| self.now_ms().saturating_add(limit_ms));
        let SwapRequest { slot, stage, shadow, .. } = request;
        let (service, from) = match checked {
            Ok(checked) => checked,
            Err((from, reason)) => {
                self.answer(id, asker, SwapReport::failed(slot, from, stage.stage, Outcome::Refused, reason));
                return id;
            }
        };
        self.pending.open(Pending::new(id, asker, service, from, stage.stage.clone(), &self.output));
        let request =
            swap::Request { id, stage: stage.stage.clone(), shadow_only: shadow, until_ms, attempts_before: 0 };
        let Some(slot) = self.swaps.slot(service) else { return id };
        if matches!(slot.coordinator.state(), State::Committed { .. } | State::Retiring { .. } | State::Aborting)
            && !self.swaps.queued.iter().any(|(queued, ..)| *queued == service)
        {
            self.swaps.queued.push((service, stage, request));
            return id;
        }
        self.begin_swap(service, stage, request);
        id
    }

    /// The slot that a request is for and what fills it, or what fills it and why the request cannot be met.
    fn checked(&self, request: &SwapRequest) -> Result<(Service, String), (String, String)> {
        let launch = &self.config.launch;
        let here = Service::named(&request.slot).filter(|service| self.swaps.slot(*service).is_some());
        let Some((service, from)) = here.and_then(|service| Some((service, launch.slot(service)?))) else {
            let slots: Vec<_> = self.swaps.slots.iter().map(|slot| slot.service.name()).collect();
            let meant =
                nearest(&request.slot, &slots).map_or(String::new(), |slot| format!("; did you mean `{slot}`?"));
            let reason = format!("there is no slot `{}` here{meant}; there are {}", request.slot, slots.join(", "));
            return Err((String::new(), reason));
        };
        let from = from.stage.clone();
        if let Err(reason) = self.check_stage(service, &request.stage) {
            return Err((from, reason));
        }
        let epoch = self.swaps.epoch(service).unwrap_or(0);
        match request.expected_epoch.filter(|expected| *expected != epoch) {
            Some(expected) => Err((
                from,
                format!(
                    "the last decision about `{service}` is number {epoch}, not {expected}; ask how it is, and again"
                ),
            )),
            None => Ok((service, from)),
        }
    }

    /// What is wrong with a stage for a slot, for people.
    fn check_stage(&self, service: Service, stage: &Stage) -> Result<(), String> {
        self.config.launch.may_fill(service, &stage.stage).map_err(|error| error.to_string())?;
        let mut launch: Launch = self.config.launch.clone();
        if let Some(slot) = launch.slot_mut(service) {
            slot.clone_from(stage);
        }
        (self.config.validate)(&launch, service)
    }

    /// Asks the slot's coordinator. Who asks for the stage that already runs beside it asks for its promotion.
    fn begin_swap(&mut self, service: Service, stage: Stage, request: swap::Request) {
        let Some(slot) = self.swaps.slot_mut(service) else { return };
        let shadows = matches!(slot.coordinator.state(), State::Starting | State::CatchingUp | State::Shadowing);
        let promotes = slot.candidate.as_ref() == Some(&stage) && !request.shadow_only && shadows;
        let is_idle = slot.coordinator.state() == State::Idle;
        if is_idle {
            slot.candidate = Some(stage);
        }
        if is_idle || promotes {
            slot.attempt.begin(&request);
        }
        let until_ms = request.until_ms;
        let event = if promotes { swap::Event::Promote { until_ms } } else { swap::Event::Request(request) };
        self.notify_slot(service, event);
    }

    /// Takes what has happened since the last time to the coordinators, and answers what is settled.
    pub(crate) fn poll_swaps(&mut self) {
        let idle = |slot: &Slot| slot.coordinator.state() == State::Idle;
        let free: Vec<_> = self.swaps.slots.iter().filter(|slot| idle(slot)).map(|slot| slot.service).collect();
        while let Some(place) = self.swaps.queued.iter().position(|(service, ..)| free.contains(service)) {
            let (service, stage, request) = self.swaps.queued.swap_remove(place);
            self.begin_swap(service, stage, request);
        }
        for service in self.swaps.services() {
            self.poll_slot(service);
        }
        for (id, asker, report) in self.pending.finish(self.now_ms(), &self.output) {
            self.answer(id, asker, report);
        }
    }

    fn poll_slot(&mut self, service: Service) {
        // Where the samples are on another host, what was made of them tells it.
        let newest = self.published[Service::Ingest as usize].max(self.published[Service::Gyro as usize]);
        self.notify_slot(service, swap::Event::NewestInput { tick: newest.saturating_sub(1) });
        let next_tick = self.readers_tick(service);
        self.notify_slot(service, swap::Event::ReadersKeep { next_tick });
        // What it has published says more about how far it is than what it said last, but for what the candidate may have published.
        let changes_at = self.swaps.slot(service).and_then(|slot| match slot.coordinator.state() {
            State::Armed { from_tick } => Some(from_tick),
            _ => None,
        });
        let published = self.published[service as usize];
        let published = if changes_at.is_none_or(|from_tick| published <= from_tick) { published } else { 0 };
        let entry = self.table.entry(service);
        let (active, candidate) = (entry.health().copied(), entry.candidate_health().copied());
        if let Some(health) = active {
            self.notify_slot(service, ownership_status(&health, published));
        }
        let Some(health) = candidate else { return };
        self.notify_slot(service, ownership_status(&health, 0));
        if let Some(slot) = self.swaps.slot_mut(service)
            && !std::mem::replace(&mut slot.ready, true)
        {
            self.notify_slot(service, swap::Event::Ready { incarnation: health.incarnation });
        }
    }

    /// The first tick that a reader of the slot could need again.
    fn readers_tick(&self, service: Service) -> u64 {
        let readers = self.checkpoints.readers(service);
        if readers.is_empty() {
            return self.output.next_tick;
        }
        let readers = readers.iter().filter(|reader| !self.table.entry(**reader).away);
        let kept = readers.filter_map(|reader| self.checkpoints.resume_tick(*reader));
        kept.min().unwrap_or(0)
    }

    /// Tells a slot's coordinator, and does what it asks for.
    pub(crate) fn notify_slot(&mut self, service: Service, event: swap::Event) {
        let now_ms = self.now_ms();
        let Some(slot) = self.swaps.slot_mut(service) else { return };
        for action in slot.coordinator.handle(now_ms, event) {
            self.act(service, action);
        }
    }

    fn act(&mut self, service: Service, action: swap::Action) {
        match action {
            swap::Action::SpawnCandidate { epoch, .. } => {
                let resume = self.checkpoints.resume_candidate(service);
                self.spawn_candidate(service, epoch, Role::Candidate, resume);
            }
            swap::Action::SpawnOwner { epoch, from_tick, .. } => {
                let resume = self.checkpoints.resume(service, from_tick);
                self.spawn_candidate(service, epoch, Role::Owner { from_tick }, resume);
            }
            swap::Action::PublishControl(swap::Control { epoch, owner, from_tick }) => {
                let control = messages::Control { from_tick, epoch, service: service as u32, owner, reserved: 0 };
                self.actions.push(Action::PublishControl(control));
                self.tell_owner(service, epoch, owner, from_tick);
            }
            swap::Action::EndCandidate { incarnation } | swap::Action::RetireOld { incarnation } => {
                self.table.dismiss(service, incarnation, &mut self.actions);
            }
            swap::Action::RestartActive { epoch, from_tick } => {
                let entry = self.table.entry_mut(service);
                entry.ownership = Some((epoch, from_tick));
                let incarnation = entry.incarnation();
                if entry.process.is_some() {
                    self.actions.push(Action::Kill { incarnation });
                }
                // What another has published in its place was taken; it goes on behind that.
                if self.swaps.slot(service).is_some_and(|slot| slot.replaced) {
                    self.tell_owner(service, epoch, incarnation, self.published[service as usize].max(from_tick));
                }
            }
            swap::Action::Answer(report) => self.on_swap_answer(service, &report),
        }
    }

    /// Tells that a slot stays whose it was: what another had of it lies behind what was published.
    pub(crate) fn tell_kept(&mut self, service: Service) {
        let incarnation = self.table.entry(service).incarnation();
        self.tell_owner(service, FIRST_EPOCH, incarnation, self.published[service as usize]);
    }

    /// Tells a decision, with what there is to know of the owner.
    fn tell_owner(&mut self, service: Service, epoch: u32, owner: u32, from_tick: u64) {
        let is_beside = self.table.is_candidate(service as u32, owner);
        let Some(slot) = self.swaps.slot_mut(service) else { return };
        let filling = if is_beside { slot.beside.as_ref() } else { slot.fillings.owner() };
        let filling = filling.filter(|_| owner != 0).cloned();
        let replaces_until = filling.as_ref().and_then(|filling| filling.replaces_until);
        slot.replaced = is_beside && replaces_until.is_some();
        let from_tick = if is_beside { replaces_until.unwrap_or(0).max(from_tick) } else { from_tick };
        self.tell_filling(EventKind::OWNER, service, owner, epoch, from_tick, filling.as_ref());
    }

    /// Starts a stage beside the one that fills the slot, or in the place of one that has ended; a candidate that is still there is killed.
    fn spawn_candidate(&mut self, service: Service, epoch: u32, role: Role, resume: Resume) {
        self.checkpoints.forget_candidate(service);
        let Some(slot) = self.swaps.slot_mut(service) else { return };
        slot.ready = false;
        let stage = slot.candidate.clone();
        let replaces_until = (role != Role::Candidate).then(|| self.published[service as usize]);
        slot.beside = stage.clone().map(|stage| slot.fillings.next(stage, &resume, replaces_until));
        let incarnation = self.table.next_incarnation();
        let candidate = Process::new(incarnation, role != Role::Candidate, Some(&resume), self.now);
        let entry = self.table.entry_mut(service);
        if let Some(before) = entry.candidate.replace(candidate) {
            self.actions.push(Action::Kill { incarnation: before.incarnation });
            entry.retired.push(before);
        }
        let resume = Some(resume);
        self.actions.push(Action::Spawn(Box::new(Spawn { incarnation, service, stage, role, epoch, resume })));
    }

    fn on_swap_answer(&mut self, service: Service, report: &swap::Report) {
        if self.tries_again(service, report) {
            return;
        }
        let now_ms = self.now_ms();
        let Some(slot) = self.swaps.slot_mut(service) else { return };
        let committed = report.outcome == Outcome::Committed;
        if committed && let Some(stage) = slot.candidate.take() {
            self.checkpoints.promote(service);
            let entry = self.table.entry_mut(service);
            entry.retired.extend(std::mem::replace(&mut entry.process, entry.candidate.take()));
            (entry.away, entry.due) = (false, None);
            entry.policy.reset();
            if let Some(slot) = self.config.launch.slot_mut(service) {
                *slot = stage;
            }
            if let Some(slot) = self.swaps.slot_mut(service)
                && let Some(filling) = slot.beside.take()
            {
                slot.fillings.enter(filling);
                slot.replaced = false;
            }
        } else if !committed && !matches!(report.reason, Some(Reason::Busy { .. })) {
            slot.candidate = None;
        }
        let last_words = self.swaps.slot(service).map_or("", |slot| &slot.last_words);
        self.pending.settle(service, report, last_words, now_ms);
    }

    /// Begins again with a request whose change of hands has been taken back because it came too late, unless that was often enough.
    fn tries_again(&mut self, service: Service, report: &swap::Report) -> bool {
        let too_late =
            matches!(report.reason, Some(Reason::NotConfirmed { .. } | Reason::ActiveMissed | Reason::CandidateMissed));
        let (now_ms, Some(slot)) = (self.now_ms(), self.swaps.slot_mut(service)) else { return false };
        let Attempt { id, until_ms, times } = slot.attempt;
        if !too_late || times >= ATTEMPTS_MAX || now_ms >= until_ms {
            return false;
        }
        let Some(stage) = slot.candidate.take() else { return false };
        // In lockstep the source waits for the decision.
        let attempts_before = if self.config.lockstep { 0 } else { times };
        let request = swap::Request { id, stage: stage.stage.clone(), shadow_only: false, until_ms, attempts_before };
        self.swaps.queued.push((service, stage, request));
        self.announce(format!("{service}: the change of hands came too late; it is tried again"));
        true
    }

    /// Every request that waits is answered with the reason why nothing comes of it.
    pub(crate) fn abort_requests(&mut self, reason: &str) {
        for (id, asker, report) in self.pending.abort(reason, &self.output) {
            self.answer(id, asker, report);
        }
    }

    fn answer(&mut self, id: u64, asker: Asker, report: SwapReport) {
        self.tell_report(&report);
        match asker {
            Asker::Watch(service) => self.on_watch_answer(service, id, report),
            Asker::Caller { caller, .. } => {
                self.announce(report.to_string());
                self.actions.push(Action::Answer { caller, reply: Reply::Swap(Box::new(report)) });
            }
            Asker::Nobody => self.announce(report.to_string()),
        }
    }

    pub(crate) fn now_ms(&self) -> u64 {
        self.now.as_millis() as u64
    }
}

fn limits(config: &Config) -> Limits {
    let Config { rate_hz, lockstep, window_ticks, .. } = *config;
    let margin_ticks = if lockstep { window_ticks } else { (rate_hz * MARGIN_S) as u64 }.max(8);
    let longest_margin_ticks = if lockstep { margin_ticks } else { margin_ticks << (ATTEMPTS_MAX - 1) };
    Limits {
        ready_ms: 10_000,
        caught_up_ms: 5_000,
        shadow_ms: 100,
        commit_ms: 300 + (longest_margin_ticks as f64 / rate_hz * 1e3) as u64,
        restore_ms: 500,
        // In lockstep readers that are away find what they lack however late they come back: a stage that is to begin in the place of
        // one that has ended may take `ready_ms` to fail, and each process that is then started as long again.
        linger_ms: if lockstep { 60_000 } else { 1_000 },
        end_ms: 400,
        lag_max_ticks: ((rate_hz * 0.02) as u64).max(8),
        margin_ticks,
    }
}

/// What a service said, as a coordinator takes it.
fn ownership_status(health: &Health, published_tick: u64) -> swap::Event {
    let status = OwnershipStatus {
        next_tick: health.next_tick.max(published_tick),
        decided_epoch: health.epoch,
        missed: health.missed != 0,
        published_from: Some(health.published_from).filter(|tick| *tick != u64::MAX),
    };
    swap::Event::Health { incarnation: health.incarnation, status, flawed: health.flawed > 0 }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bytemuck::Zeroable;
    use messages::{Control, State};

    use super::*;
    use crate::{ControlRequest, Event};

    const RATE_HZ: f64 = 100.0;
    const ALL: [Service; 5] = [Service::Ingest, Service::Gyro, Service::Accel, Service::Fuser, Service::Course];

    /// A system at 100 Hz that knows no fault but one: candidates that do not hear of a decision.
    struct System {
        supervision: Supervision,
        processes: Vec<(u32, Service)>,
        /// The first of them do not hear.
        deaf: usize,
        candidates: Vec<u32>,
        control: Control,
        reports: Vec<SwapReport>,
    }

    impl System {
        fn new(deaf: usize) -> Self {
            let config = Config {
                launch: Launch::default(),
                rate_hz: RATE_HZ,
                lockstep: false,
                window_ticks: 0,
                buffer_ticks: 2000,
                stop_after: None,
                validate: |_, _| Ok(()),
            };
            let supervision = Supervision::new(config, Duration::ZERO);
            let (processes, candidates, reports) = (Vec::new(), Vec::new(), Vec::new());
            Self { supervision, processes, deaf, candidates, control: Control::zeroed(), reports }
        }

        fn notify_slot(&mut self, now: Duration, event: Event) {
            for action in self.supervision.handle(now, event) {
                match action {
                    Action::Spawn(spawn) => {
                        if spawn.role == Role::Candidate {
                            self.candidates.push(spawn.incarnation);
                        }
                        self.processes.push((spawn.incarnation, spawn.service));
                        self.notify_slot(
                            now,
                            Event::Spawned { incarnation: spawn.incarnation, pid: spawn.incarnation },
                        );
                    }
                    Action::Terminate { incarnation } | Action::Kill { incarnation } => {
                        self.processes.retain(|(process, _)| *process != incarnation);
                        let exited = Event::Exited { incarnation, how: String::new(), stderr: String::new() };
                        self.notify_slot(now, exited);
                    }
                    Action::PublishControl(control) => self.control = control,
                    Action::Answer { reply: Reply::Swap(report), .. } => self.reports.push(*report),
                    _ => {}
                }
            }
        }

        /// Ten milliseconds after the ones before, a tick later.
        fn go_on(&mut self, tick: u64) {
            let now = Duration::from_millis(10 * tick);
            for (incarnation, service) in self.processes.clone() {
                let hears = !self.candidates.iter().take(self.deaf).any(|deaf| *deaf == incarnation);
                let decided = if service == Service::Fuser && hears { self.control } else { Control::zeroed() };
                let begins = decided.owner == incarnation && tick > decided.from_tick;
                self.notify_slot(
                    now,
                    Event::Health(Health {
                        service: service as u32,
                        incarnation,
                        state: State::RUNNING,
                        ticks: tick,
                        next_tick: tick,
                        epoch: decided.epoch.max(FIRST_EPOCH),
                        published_from: if begins { decided.from_tick } else { u64::MAX },
                        ..Health::zeroed()
                    }),
                );
            }
            ALL.into_iter().for_each(|service| self.notify_slot(now, Event::Published { service, next_tick: tick }));
            self.notify_slot(now, Event::Output(OutputProgress { next_tick: tick, ..OutputProgress::default() }));
            self.notify_slot(now, Event::Time);
        }

        /// How a swap ends that is asked for after a second, and how many candidates there were.
        fn swapped(mut self) -> (SwapReport, usize) {
            (0..100).for_each(|tick| self.go_on(tick));
            let stage = Stage { stage: "vqf".into(), ..Launch::default().fuser };
            let request =
                SwapRequest { slot: "fuser".into(), stage, shadow: false, expected_epoch: None, limit_ms: None };
            self.notify_slot(
                Duration::from_secs(1),
                Event::Request { caller: 1, request: ControlRequest::Swap(request) },
            );
            (100..2000).for_each(|tick| self.go_on(tick));
            let [report] = <[SwapReport; 1]>::try_from(self.reports).unwrap();
            (report, self.candidates.len())
        }
    }

    #[test]
    fn a_change_of_hands_that_comes_too_late_is_tried_again() {
        let (report, candidates) = System::new(0).swapped();
        assert_eq!((report.outcome, candidates), (Outcome::Committed, 1), "{report:?}");
        let (report, candidates) = System::new(2).swapped();
        assert_eq!((report.outcome, candidates), (Outcome::Committed, 3), "{report:?}");
    }

    #[test]
    fn one_that_always_comes_too_late_is_given_up() {
        let (report, candidates) = System::new(usize::MAX).swapped();
        assert_eq!((report.outcome, candidates), (Outcome::Aborted, 3), "{report:?}");
        assert!(report.reason.is_some_and(|reason| reason.contains("was not confirmed in time")));
    }
}
