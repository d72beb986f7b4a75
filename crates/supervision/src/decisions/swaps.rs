//! Slot ownership: one coordinator per slot, with its events and actions.

use control::{SwapReport, SwapRequest};
use foreign::ForeignText;
use launch::{Launch, Service, Slot, StageConfig};
use mapping::names::UnknownName;
use messages::{EventKind, Health, SystemEvent};
use swap::{Coordinator, FIRST_EPOCH, FailureReason, OwnershipStatus, Progress, Resume, Role, SwapOutcome, SwapState};

use crate::{
    Action, OutputProgress, Reply, Spawn, Supervision,
    decisions::swap_timing::{MAX_ATTEMPTS, swap_limits},
    state::{
        pending_swaps::{Pending, Requester},
        process::Process,
        stage_history::{StageHistory, with_stage},
        swaps::{Attempt, SlotState, Swaps},
    },
};

impl Supervision {
    /// Creates the slots, each owned by the newest process of its service.
    pub(crate) fn init_slots(&mut self) {
        let limits = swap_limits(&self.config);
        let entries = self.entries().filter_map(|(service, entry)| Some((service.slot()?, entry)));
        let slots = entries.map(|(slot, entry)| SlotState {
            slot,
            coordinator: Coordinator::new(entry.incarnation(), FIRST_EPOCH, limits),
            candidate: None,
            history: match self.swaps.history(slot) {
                Some(history) => history.clone(),
                None => StageHistory::new(self.config.launch.stage(slot).clone()),
            },
            candidate_instance: None,
            owned_by_replacement: false,
            attempt: Attempt::default(),
            ready_reported: false,
            last_stderr: ForeignText::default(),
        });
        self.swaps = Swaps { slots: slots.collect(), requests: self.swaps.requests, queued: Vec::new() };
    }

    /// Returns `true` while a swap is in progress.
    pub(crate) fn is_swapping(&self) -> bool {
        self.pending.has_pending() || self.swaps.is_active()
    }

    pub(crate) fn on_published(&mut self, service: Service, next_tick: u64) {
        let published = &mut self.published[service as usize];
        *published = next_tick.max(*published);
        let next_tick = *published;
        self.notify_slot_of(service, swap::Event::Published { next_tick });
    }

    pub(crate) fn on_output(&mut self, output: OutputProgress) {
        let before = std::mem::replace(&mut self.output, output);
        let losses = [
            (EventKind::LOST, output.lost.saturating_sub(before.lost)),
            (EventKind::NOT_RECORDED, output.not_recorded.saturating_sub(before.not_recorded)),
        ];
        for (kind, ticks) in losses.into_iter().filter(|(_, ticks)| *ticks > 0) {
            self.publish_event(SystemEvent { tick: output.next_tick, ticks, ..SystemEvent::new(kind) });
        }
        self.checkpoints.on_output(output.next_tick);
        self.pending.record_gap(output.max_gap_ns);
    }

    pub(crate) fn on_swap_request(&mut self, client: u64, request: SwapRequest) {
        if self.validate_request(&request).is_ok() {
            self.suspend_watch(&request.slot);
        }
        let slot = Slot::from_name(&request.slot).filter(|_| request.shadow);
        self.request_swap(request, Requester::Client { client, shadow: slot });
    }

    /// Cancels the shadow that a disconnected client has requested.
    pub(crate) fn on_client_disconnected(&mut self, client: u64) {
        if let Some(slot) = self.pending.detach_client(client) {
            self.notify_slot(slot, swap::Event::Cancel);
        }
    }

    /// Handles a swap request and returns its ID, which is also the ID of its report.
    pub(crate) fn request_swap(&mut self, request: SwapRequest, requester: Requester) -> u64 {
        self.swaps.requests += 1;
        let id = self.swaps.requests;
        let validated = self.validate_request(&request);
        let kind = if request.shadow { EventKind::SHADOW_REQUESTED } else { EventKind::SWAP_REQUESTED };
        let service_id = Service::from_name(&request.slot).map_or(SystemEvent::NONE_U32, |service| service as u32);
        self.publish_event(SystemEvent { service: service_id, ..with_stage(SystemEvent::new(kind), &request.stage) });
        let deadline_ms = request.timeout_ms.map_or(u64::MAX, |timeout_ms| self.now_ms().saturating_add(timeout_ms));
        let SwapRequest { slot: slot_name, stage, shadow, .. } = request;
        let (slot, from) = match validated {
            Ok(checked) => checked,
            Err((from, reason)) => {
                self.reply(
                    id,
                    requester,
                    SwapReport::failed(slot_name, from, stage.stage, SwapOutcome::Refused, reason),
                );
                return id;
            }
        };
        self.pending.push(Pending::new(id, requester, slot, from, stage.stage.clone(), &self.output));
        let request =
            swap::Request { id, stage: stage.stage.clone(), shadow_only: shadow, deadline_ms, previous_attempts: 0 };
        let Some(state) = self.swaps.state(slot) else { return id };
        if matches!(
            state.coordinator.state(),
            SwapState::Committed { .. } | SwapState::Retiring { .. } | SwapState::Aborting
        ) && !self.swaps.queued.iter().any(|(queued, ..)| *queued == slot)
        {
            self.swaps.queued.push((slot, stage, request));
            return id;
        }
        self.start_swap(slot, stage, request);
        id
    }

    /// Validates a request and returns its slot and the current stage.
    ///
    /// # Errors
    ///
    /// Returns the current stage and the reason for the rejection. The stage is empty if the slot
    /// does not exist.
    fn validate_request(&self, request: &SwapRequest) -> Result<(Slot, String), (String, String)> {
        let launch = &self.config.launch;
        let Some(slot) = Slot::from_name(&request.slot).filter(|slot| self.swaps.state(*slot).is_some()) else {
            let slots = self.swaps.slots.iter().map(|state| state.slot.name());
            return Err((String::new(), UnknownName::new("slot", &request.slot, slots).to_string()));
        };
        let from = launch.stage(slot).stage.clone();
        if let Err(reason) = self.validate_stage(slot, &request.stage) {
            return Err((from, reason));
        }
        let epoch = self.swaps.epoch(slot).unwrap_or(0);
        match request.expected_epoch.filter(|expected| *expected != epoch) {
            Some(expected) => {
                Err((from, format!("the epoch of `{slot}` is {epoch}, not {expected}; read its status and retry")))
            }
            None => Ok((slot, from)),
        }
    }

    /// Checks that a stage can fill a slot. The error is shown to the user.
    fn validate_stage(&self, slot: Slot, stage: &StageConfig) -> Result<(), String> {
        self.config.launch.validate_stage(slot, &stage.stage).map_err(|error| error.to_string())?;
        let mut launch: Launch = self.config.launch.clone();
        launch.stage_mut(slot).clone_from(stage);
        (self.config.validate)(&launch, slot)
    }

    /// Passes a request to the slot's coordinator. A request for the stage that already runs as a
    /// shadow promotes it.
    fn start_swap(&mut self, slot: Slot, stage: StageConfig, request: swap::Request) {
        let Some(state) = self.swaps.state_mut(slot) else { return };
        let is_running =
            matches!(state.coordinator.state(), SwapState::Starting | SwapState::CatchingUp | SwapState::Shadowing);
        let promotes = state.candidate.as_ref() == Some(&stage) && !request.shadow_only && is_running;
        let is_idle = state.coordinator.state() == SwapState::Idle;
        if is_idle {
            state.candidate = Some(stage);
        }
        if is_idle || promotes {
            state.attempt.start(&request);
        }
        let deadline_ms = request.deadline_ms;
        let event = if promotes { swap::Event::Promote { deadline_ms } } else { swap::Event::Request(request) };
        self.notify_slot(slot, event);
    }

    /// Passes the newest observations to the coordinators and replies to settled requests.
    pub(crate) fn poll_swaps(&mut self) {
        let is_idle = |state: &SlotState| state.coordinator.state() == SwapState::Idle;
        let idle: Vec<_> = self.swaps.slots.iter().filter(|state| is_idle(state)).map(|state| state.slot).collect();
        while let Some(index) = self.swaps.queued.iter().position(|(slot, ..)| idle.contains(slot)) {
            let (slot, stage, request) = self.swaps.queued.swap_remove(index);
            self.start_swap(slot, stage, request);
        }
        for slot in self.swaps.slots() {
            self.poll_slot(slot);
        }
        for (id, requester, report) in self.pending.take_settled(self.now_ms(), &self.output) {
            self.reply(id, requester, report);
        }
    }

    fn poll_slot(&mut self, slot: Slot) {
        // If ingest runs on another host, the output of the gyro indicates the newest sample.
        let newest = self.published[Service::Ingest as usize].max(self.published[Service::Gyro as usize]);
        self.notify_slot(slot, swap::Event::NewestInput { tick: newest.saturating_sub(1) });
        let next_tick = self.subscribers_resume_tick(Service::from(slot));
        self.notify_slot(slot, swap::Event::SubscribersCheckpointed { next_tick });
        // The topic is more up to date than the health report of the active stage. From the
        // hand-over on, however, the topic may also contain outputs of the candidate.
        let hand_over_tick = self.swaps.state(slot).and_then(|state| match state.coordinator.state() {
            SwapState::Armed { from_tick } => Some(from_tick),
            _ => None,
        });
        let published = self.published[Service::from(slot) as usize];
        let published = if hand_over_tick.is_none_or(|from_tick| published <= from_tick) { published } else { 0 };
        let entry = self.table.entry(Service::from(slot));
        let (active, candidate) = (entry.health().copied(), entry.candidate_health().copied());
        if let Some(health) = active {
            self.notify_slot(slot, ownership_status(&health, published));
        }
        let Some(health) = candidate else { return };
        self.notify_slot(slot, ownership_status(&health, 0));
        if let Some(state) = self.swaps.state_mut(slot)
            && !std::mem::replace(&mut state.ready_reported, true)
        {
            self.notify_slot(slot, swap::Event::Ready { incarnation: health.incarnation });
        }
    }

    /// Returns the first tick that a subscriber of the service could need again.
    fn subscribers_resume_tick(&self, service: Service) -> u64 {
        let subscribers = self.checkpoints.subscribers(service);
        if subscribers.is_empty() {
            return self.output.next_tick;
        }
        let subscribers = subscribers.iter().filter(|subscriber| !self.table.entry(**subscriber).given_up);
        let resume_ticks = subscribers.filter_map(|subscriber| self.checkpoints.resume_tick(*subscriber));
        resume_ticks.min().unwrap_or(0)
    }

    /// Passes an event to a slot's coordinator and performs the resulting actions.
    pub(crate) fn notify_slot(&mut self, slot: Slot, event: swap::Event) {
        let now_ms = self.now_ms();
        let Some(state) = self.swaps.state_mut(slot) else { return };
        for action in state.coordinator.handle(now_ms, event) {
            self.apply_swap_action(slot, action);
        }
    }

    /// Passes an event of a service to the coordinator of its slot. Does nothing if the service has
    /// no slot.
    pub(crate) fn notify_slot_of(&mut self, service: Service, event: swap::Event) {
        if let Some(slot) = service.slot() {
            self.notify_slot(slot, event);
        }
    }

    fn apply_swap_action(&mut self, slot: Slot, action: swap::Action) {
        let service = Service::from(slot);
        match action {
            swap::Action::SpawnCandidate { epoch, .. } => {
                let resume = self.checkpoints.resume_candidate(service);
                self.spawn_candidate(slot, epoch, Role::Candidate, resume);
            }
            swap::Action::SpawnOwner { epoch, from_tick, .. } => {
                let resume = self.checkpoints.resume(service, from_tick);
                self.spawn_candidate(slot, epoch, Role::Owner { from_tick }, resume);
            }
            swap::Action::PublishDecision(swap::OwnershipDecision { epoch, owner, from_tick }) => {
                let control = messages::Control { from_tick, epoch, service: service as u32, owner, reserved: 0 };
                self.actions.push(Action::PublishControl(control));
                self.publish_owner(slot, epoch, owner, from_tick);
            }
            swap::Action::StopCandidate { incarnation } | swap::Action::RetirePrevious { incarnation } => {
                self.table.terminate(service, incarnation, &mut self.actions);
            }
            swap::Action::RestartActive { epoch, from_tick } => {
                let entry = self.table.entry_mut(service);
                entry.ownership = Some((epoch, from_tick));
                let incarnation = entry.incarnation();
                if entry.owner.is_some() {
                    self.actions.push(Action::Kill { incarnation });
                }
                // The replacement's output has been delivered, so the previous owner resumes
                // after the replacement's last tick.
                if self.swaps.state(slot).is_some_and(|state| state.owned_by_replacement) {
                    self.publish_owner(slot, epoch, incarnation, self.published[service as usize].max(from_tick));
                }
            }
            swap::Action::Report(report) => self.on_swap_report(slot, &report),
        }
    }

    /// Publishes the event that the owner of a slot is unchanged. The tick of the event is the one
    /// after the newest tick published for the slot.
    pub(crate) fn publish_owner_unchanged(&mut self, slot: Slot) {
        let incarnation = self.table.entry(Service::from(slot)).incarnation();
        self.publish_owner(slot, FIRST_EPOCH, incarnation, self.published[Service::from(slot) as usize]);
    }

    /// Publishes an event about an ownership decision, with the details of the owner.
    fn publish_owner(&mut self, slot: Slot, epoch: u32, owner: u32, from_tick: u64) {
        let service = Service::from(slot);
        let is_candidate = self.table.is_candidate(service as u32, owner);
        let Some(state) = self.swaps.state_mut(slot) else { return };
        let instance = if is_candidate { state.candidate_instance.as_ref() } else { state.history.owner() };
        let instance = instance.filter(|_| owner != 0).cloned();
        let predecessor_end = instance.as_ref().and_then(|instance| instance.predecessor_end);
        state.owned_by_replacement = is_candidate && predecessor_end.is_some();
        let from_tick = if is_candidate { predecessor_end.unwrap_or(0).max(from_tick) } else { from_tick };
        self.publish_instance(EventKind::OWNER, service, owner, epoch, from_tick, instance.as_ref());
    }

    /// Starts a candidate, or a replacement of a failed owner. An existing candidate is killed.
    fn spawn_candidate(&mut self, slot: Slot, epoch: u32, role: Role, resume: Resume) {
        let service = Service::from(slot);
        self.checkpoints.clear_candidate(service);
        let Some(state) = self.swaps.state_mut(slot) else { return };
        state.ready_reported = false;
        let stage = state.candidate.clone();
        let predecessor_end = (role != Role::Candidate).then(|| self.published[service as usize]);
        state.candidate_instance =
            stage.clone().map(|stage| state.history.new_candidate(stage, &resume, predecessor_end));
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

    fn on_swap_report(&mut self, slot: Slot, report: &swap::Report) {
        if self.retry_if_late(slot, report) {
            return;
        }
        let now_ms = self.now_ms();
        let Some(state) = self.swaps.state_mut(slot) else { return };
        let committed = report.outcome == SwapOutcome::Committed;
        if committed && let Some(stage) = state.candidate.take() {
            self.checkpoints.promote(Service::from(slot));
            let entry = self.table.entry_mut(Service::from(slot));
            entry.retired.extend(std::mem::replace(&mut entry.owner, entry.candidate.take()));
            (entry.given_up, entry.restart_at) = (false, None);
            entry.policy.reset();
            *self.config.launch.stage_mut(slot) = stage;
            if let Some(state) = self.swaps.state_mut(slot)
                && let Some(instance) = state.candidate_instance.take()
            {
                state.history.push_owner(instance);
                state.owned_by_replacement = false;
            }
        } else if !committed && !matches!(report.reason, Some(FailureReason::Busy { .. })) {
            state.candidate = None;
        }
        let last_stderr = self.swaps.state(slot).map(|state| state.last_stderr.clone()).unwrap_or_default();
        self.pending.complete(slot, report, &last_stderr, now_ms);
    }

    /// Queues a request again if the decision came too late for its hand-over and attempts remain.
    /// Returns `true` if the request was queued.
    fn retry_if_late(&mut self, slot: Slot, report: &swap::Report) -> bool {
        let is_late = matches!(
            report.reason,
            Some(FailureReason::NotConfirmed { .. } | FailureReason::ActiveMissed | FailureReason::CandidateMissed)
        );
        let (now_ms, Some(state)) = (self.now_ms(), self.swaps.state_mut(slot)) else { return false };
        let Attempt { id, deadline_ms, count } = state.attempt;
        if !is_late || count >= MAX_ATTEMPTS || now_ms >= deadline_ms {
            return false;
        }
        let Some(stage) = state.candidate.take() else { return false };
        // In lockstep the source waits for the decision, so the margin need not grow.
        let attempts_before = if self.config.lockstep { 0 } else { count };
        let request = swap::Request {
            id,
            stage: stage.stage.clone(),
            shadow_only: false,
            deadline_ms,
            previous_attempts: attempts_before,
        };
        self.swaps.queued.push((slot, stage, request));
        self.announce(format!("{slot}: the hand-over was not confirmed in time; retrying"));
        true
    }

    /// Aborts every request in progress and replies with the reason.
    pub(crate) fn abort_requests(&mut self, reason: &str) {
        for (id, requester, report) in self.pending.abort_all(reason, &self.output) {
            self.reply(id, requester, report);
        }
    }

    fn reply(&mut self, id: u64, requester: Requester, report: SwapReport) {
        self.publish_swap_report(&report);
        match requester {
            Requester::Watch(slot) => self.on_watch_report(slot, id, report),
            Requester::Client { client, .. } => {
                self.announce(report.to_string());
                self.actions.push(Action::Reply { client, reply: Reply::Swap(Box::new(report)) });
            }
            Requester::Disconnected => self.announce(report.to_string()),
        }
    }

    pub(crate) fn now_ms(&self) -> u64 {
        self.now.as_millis() as u64
    }
}

/// Converts a health report to a coordinator event.
fn ownership_status(health: &Health, published_tick: u64) -> swap::Event {
    let status = OwnershipStatus {
        next_tick: health.next_tick.max(published_tick),
        decided_epoch: health.epoch,
        missed: health.missed != 0,
        published_from: Some(health.published_from).filter(|tick| *tick != u64::MAX),
    };
    let Health { incarnation, next_tick, lost, invalid_outputs, .. } = *health;
    let progress = Progress { next_tick, lost };
    swap::Event::Health { incarnation, status, progress, invalid_output: invalid_outputs > 0 }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bytemuck::Zeroable;
    use messages::{Control, State};

    use control::ControlRequest;

    use super::*;
    use crate::{Config, Event};

    const RATE_HZ: f64 = 100.0;
    const ALL: [Service; 5] = [Service::Ingest, Service::Gyro, Service::Accel, Service::Fuser, Service::Course];

    /// System at 100 Hz without faults, except for candidates that do not respond to decisions.
    struct System {
        supervision: Supervision,
        processes: Vec<(u32, Service)>,
        /// Number of candidates, counted from the first, that do not respond.
        unresponsive: usize,
        candidates: Vec<u32>,
        control: Control,
        reports: Vec<SwapReport>,
    }

    impl System {
        fn new(unresponsive: usize) -> Self {
            let config = Config {
                launch: Launch { services: Service::PATH.into(), ..Launch::default() },
                rate_hz: RATE_HZ,
                lockstep: false,
                window_ticks: 0,
                buffer_ticks: 2000,
                stop_after: None,
                validate: |_, _| Ok(()),
            };
            let supervision = Supervision::new(config, Duration::ZERO);
            let (processes, candidates, reports) = (Vec::new(), Vec::new(), Vec::new());
            Self { supervision, processes, unresponsive, candidates, control: Control::zeroed(), reports }
        }

        fn handle(&mut self, now: Duration, event: Event) {
            for action in self.supervision.handle(now, event) {
                match action {
                    Action::Spawn(spawn) => {
                        if spawn.role == Role::Candidate {
                            self.candidates.push(spawn.incarnation);
                        }
                        self.processes.push((spawn.incarnation, spawn.service));
                        self.handle(now, Event::Spawned { incarnation: spawn.incarnation, pid: spawn.incarnation });
                    }
                    Action::Terminate { incarnation } | Action::Kill { incarnation } => {
                        self.processes.retain(|(process, _)| *process != incarnation);
                        let exited =
                            Event::Exited { incarnation, exit_status: String::new(), stderr: ForeignText::default() };
                        self.handle(now, exited);
                    }
                    Action::PublishControl(control) => self.control = control,
                    Action::Reply { reply: Reply::Swap(report), .. } => self.reports.push(*report),
                    _ => {}
                }
            }
        }

        /// Simulates one tick of 10 ms.
        fn step(&mut self, tick: u64) {
            let now = Duration::from_millis(10 * tick);
            for (incarnation, service) in self.processes.clone() {
                let is_responsive = !self.candidates.iter().take(self.unresponsive).any(|deaf| *deaf == incarnation);
                let decided = if service == Service::Fuser && is_responsive { self.control } else { Control::zeroed() };
                let publishes = decided.owner == incarnation && tick > decided.from_tick;
                self.handle(
                    now,
                    Event::Health(Health {
                        service: service as u32,
                        incarnation,
                        state: State::RUNNING,
                        ticks: tick,
                        next_tick: tick,
                        epoch: decided.epoch.max(FIRST_EPOCH),
                        published_from: if publishes { decided.from_tick } else { u64::MAX },
                        ..Health::zeroed()
                    }),
                );
            }
            ALL.into_iter().for_each(|service| self.handle(now, Event::Published { service, next_tick: tick }));
            self.handle(now, Event::Output(OutputProgress { next_tick: tick, ..OutputProgress::default() }));
            self.handle(now, Event::Timer);
        }

        /// Requests a swap after 1 s and returns its report and the number of candidates started.
        fn run_swap(mut self) -> (SwapReport, usize) {
            (0..100).for_each(|tick| self.step(tick));
            let stage = StageConfig { stage: "vqf".into(), ..Launch::default().fuser };
            let request =
                SwapRequest { slot: "fuser".into(), stage, shadow: false, expected_epoch: None, timeout_ms: None };
            self.handle(Duration::from_secs(1), Event::Request { client: 1, request: ControlRequest::Swap(request) });
            (100..2000).for_each(|tick| self.step(tick));
            let [report] = <[SwapReport; 1]>::try_from(self.reports).unwrap();
            (report, self.candidates.len())
        }
    }

    #[test]
    fn late_hand_over_is_retried() {
        let (report, candidates) = System::new(0).run_swap();
        assert_eq!((report.outcome, candidates), (SwapOutcome::Committed, 1), "{report:?}");
        let (report, candidates) = System::new(2).run_swap();
        assert_eq!((report.outcome, candidates), (SwapOutcome::Committed, 3), "{report:?}");
    }

    #[test]
    fn hand_over_that_is_always_late_is_aborted() {
        let (report, candidates) = System::new(usize::MAX).run_swap();
        assert_eq!((report.outcome, candidates), (SwapOutcome::Aborted, 3), "{report:?}");
        assert!(report.reason.is_some_and(|reason| reason.raw().contains("was not confirmed in time")));
    }
}
