//! Shell around the core of the supervisor: passes events to the core and executes its actions.

use std::time::Duration;

use control::{ControlRequest, SwapRequest};
use launch::Service;
use messages::Credit;
use runtime::{
    Role, ServiceConfig,
    service_config::{FIRST_EPOCH, Resume},
};
use supervision::{Action, Event, Failure, Reply, Spawn};

use crate::{
    bus::SUPERVISOR,
    flight::{config, stage},
    process::{Process, ProcessState},
    record::{Candidate, Client},
    reference::CommittedSwap,
    setup::Fault,
    world::World,
};

/// Interval in ms between checks that the files of the bus exist. The exit of a process also
/// triggers a check.
const FILE_CHECK_INTERVAL_MS: u64 = 1000;
/// Timeout of a swap request, ms.
const SWAP_TIMEOUT_MS: u64 = 3000;

impl World {
    /// Opens the topics of the supervisor.
    pub(crate) fn join_bus(&mut self) {
        let bus = &mut self.bus;
        bus.health.subscribe(1_000_001, SUPERVISOR, false);
        bus.checkpoint.subscribe(1_000_002, SUPERVISOR, false);
        bus.difference.subscribe(1_000_003, SUPERVISOR, false);
        bus.control.add_publisher(SUPERVISOR);
        bus.credit.add_publisher(SUPERVISOR);
    }

    /// Runs one round of the supervisor.
    pub(crate) fn supervise(&mut self) -> Result<(), String> {
        let exited = std::mem::take(&mut self.exited);
        let any_exited = !exited.is_empty();
        let mut events = self.read_events();
        // Services may run between two reads by the supervisor.
        if self.random.chance(200) {
            self.poll_processes();
        }
        self.collector.collect(&mut self.bus, &mut self.random);
        events.push(Event::Output(self.collector.progress()));
        for (incarnation, exit_status) in exited {
            events.push(Event::Exited { incarnation, exit_status: exit_status.into(), stderr: Default::default() });
        }
        if let Some(fault) = self.file_fault
            && (any_exited || self.now_ms >= self.files_checked_ms + FILE_CHECK_INTERVAL_MS)
        {
            self.files_checked_ms = self.now_ms;
            events.push(Event::FilesUnusable { path: "/dev/shm/plumbline.simulated".into(), fault });
        }
        let requests = self.requests.drain(..).map(|(client, request)| Event::Request { client, request });
        events.extend(requests);
        events.extend(self.disconnected.drain(..).map(|client| Event::ClientDisconnected { client }));
        if self.stop_requested {
            events.push(Event::StopRequested);
        }
        events.push(Event::Timer);
        for event in events {
            self.handle(event)?;
        }
        let interval_ms = self.supervision.poll_interval().as_millis() as u64;
        self.wake_ms = self.now_ms + interval_ms + self.random.between(0, 2);
        Ok(())
    }

    /// Reads the messages of the services and the position of each topic.
    fn read_events(&mut self) -> Vec<Event> {
        let Self { bus, random, setup, .. } = self;
        bus.control.deliver_history(SUPERVISOR);
        bus.credit.deliver_history(SUPERVISOR);
        let mut events = Vec::new();
        while let Some(health) = bus.health.receive(1_000_001, random) {
            events.push(Event::Health(health));
        }
        while let Some(mut checkpoint) = bus.checkpoint.receive(1_000_002, random) {
            if random.chance(setup.damaged_checkpoint_per_mille) {
                checkpoint.words[random.between(0, 20) as usize] ^= 1 << random.between(0, 63);
            }
            events.push(Event::Checkpoint(Box::new(checkpoint)));
        }
        while let Some(difference) = bus.difference.receive(1_000_003, random) {
            events.push(Event::Difference(difference));
        }
        for (service, next_tick) in [
            (Service::Ingest, bus.imu.next_tick),
            (Service::Gyro, bus.gyro.next_tick),
            (Service::Accel, bus.accel.next_tick),
            (Service::Fuser, bus.fused.next_tick),
            (Service::Course, bus.attitude.next_tick),
        ] {
            events.push(Event::Published { service, next_tick });
        }
        events
    }

    fn handle(&mut self, event: Event) -> Result<(), String> {
        // A request that arrives after the system has stopped stays pending.
        if let (Event::Request { client, request }, true) = (&event, self.finished.is_some()) {
            self.requests.push_back((*client, request.clone()));
        }
        if let Event::Exited { incarnation, exit_status, .. } = &event {
            self.trace(|_| format!("process {incarnation} {exit_status}"));
        }
        for action in self.supervision.handle(Duration::from_millis(self.now_ms), event) {
            self.execute(action)?;
        }
        self.record_commitments();
        Ok(())
    }

    fn execute(&mut self, action: Action) -> Result<(), String> {
        // After the system has stopped, only replies are executed. Other actions are obsolete.
        if self.finished.is_some() && !matches!(action, Action::Reply { .. }) {
            return Ok(());
        }
        match action {
            Action::Spawn(spawn) => return self.spawn(*spawn),
            Action::Terminate { incarnation } => {
                self.trace(|_| format!("terminate {incarnation}"));
                self.process(incarnation).into_iter().for_each(|process| process.terminate_requested = true);
            }
            Action::Kill { incarnation } => {
                self.trace(|_| format!("kill {incarnation}"));
                self.process(incarnation).into_iter().for_each(|process| process.kill(None));
            }
            Action::PublishControl(control) => {
                self.trace(|_| format!("{control:?}"));
                if let Some(candidate) = self.swaps.candidates.get_mut(&control.owner) {
                    candidate.decided_from_tick = Some(control.from_tick);
                } else if control.service == Service::Fuser as u32 {
                    self.record_epoch_change(control.epoch);
                }
                self.bus.control.send(SUPERVISOR, control, &mut None);
            }
            Action::GrantCredit { ticks, is_final } => {
                self.bus.credit.send(SUPERVISOR, Credit { ticks, ends: is_final.into() }, &mut None);
            }
            Action::Reply { client: number, reply } => {
                self.trace(|_| match &reply {
                    Reply::Swap(report) => format!("reply to client {number}: {report}"),
                    _ => format!("reply to client {number}"),
                });
                let Some(client) = self.clients.get_mut(&number) else {
                    return Err(format!("reply to unknown client {number}"));
                };
                client.replies += 1;
            }
            Action::PublishEvent(_) => {}
            Action::Announce(line) => self.trace(|_| format!("announce: {line}")),
            Action::Ready => self.trace(|_| "all services run".into()),
            Action::Stopping => self.trace(|_| "stopping".into()),
            Action::RenewBus => {
                // A swapped stage may restart after the renewal but before its first tick as owner,
                // so the output may be ambiguous.
                self.swaps.ambiguous |= self.swaps.has_stage_change() || self.is_ambiguous();
                self.swaps.fuser_epoch = FIRST_EPOCH;
                self.processes.clear();
                self.exited.clear();
                self.bus = self.bus.renewed();
                self.file_fault = None;
                let config = self.config();
                self.collector.reconnect(&mut self.bus, &config);
                self.join_bus();
                return self.handle(Event::BusRenewed);
            }
            Action::Finish(failure) => {
                self.trace(|_| format!("finished: {failure:?}"));
                self.finished = Some(failure);
            }
        }
        Ok(())
    }

    fn config(&self) -> ServiceConfig {
        let max_ticks = Some(self.setup.ticks);
        ServiceConfig { pace: self.setup.pace, max_ticks, ..config(&self.setup.launch) }
    }

    fn spawn(&mut self, spawn: Spawn) -> Result<(), String> {
        let Spawn { incarnation, service, stage, role, epoch, resume } = spawn;
        let is_first = resume.is_none();
        if let (Service::Fuser, Role::Owner { .. }) = (service, role) {
            self.record_epoch_change(epoch);
        }
        // If the owner resumes at a tick before the swap, it recomputes ticks that the previous
        // stage has already published. The output is then ambiguous.
        if let (Role::Owner { from_tick }, Some(swaps)) = (role, self.swaps.committed.get(service.name())) {
            self.swaps.ambiguous |=
                swaps.iter().any(|committed| committed.changes_stage && from_tick < committed.from_tick);
        }
        // If the current stage has not sent a checkpoint yet, the process resumes from a checkpoint
        // of another stage. The output is then ambiguous.
        let checkpoint = resume.as_ref().and_then(Resume::checkpoint);
        if let (Some(checkpoint), Some(slot)) = (checkpoint, service.slot()) {
            self.swaps.ambiguous |= checkpoint.stage() != self.supervision.launch().stage(slot).stage;
        }
        let checkpoint_tick = resume.as_ref().and_then(Resume::next_tick);
        self.record_candidate(incarnation, service, stage.as_ref(), role, checkpoint_tick);
        if self.random.chance(self.setup.spawn_failure_per_mille) && !(is_first && self.setup.strict) {
            self.trace(|_| format!("{service} {incarnation}: spawn failed"));
            return self.handle(Event::SpawnFailed { incarnation, cause: "no such file".into() });
        }
        self.restarts += u64::from(!is_first);
        let mut launch = self.supervision.launch().clone();
        if let Some((slot, stage)) = service.slot().zip(stage) {
            *launch.stage_mut(slot) = stage;
        }
        let config = ServiceConfig { launch, incarnation, epoch, role, resume, ..self.config() };
        let candidate = role == Role::Candidate;
        let hangs = self.random.chance(self.setup.hung_start_per_mille) && !(is_first && self.setup.strict);
        let fails = self.random.chance(self.setup.failed_start_per_mille) && !(is_first && self.setup.strict);
        let wake_ms = self.now_ms + self.random.between(1, self.setup.max_start_ms);
        let is_invalid = candidate && self.random.chance(self.setup.invalid_output_per_mille);
        self.trace(|_| format!("{service} {incarnation} starts: {role:?}, epoch {epoch}, from {checkpoint_tick:?}"));
        self.processes.push(Process {
            incarnation,
            service,
            candidate,
            state: if hangs {
                ProcessState::Unresponsive
            } else {
                ProcessState::Starting { config: Box::new(config), fails }
            },
            wake_ms,
            frozen_until_ms: 0,
            terminate_requested: false,
            deliveries_left: None,
            invalid_from_tick: is_invalid.then(|| self.bus.imu.next_tick + self.random.between(0, 60)),
            exit_status: None,
        });
        self.handle(Event::Spawned { incarnation, pid: incarnation })
    }

    fn process(&mut self, incarnation: u32) -> Option<&mut Process> {
        self.processes.iter_mut().find(|process| process.incarnation == incarnation)
    }

    /// Records a new epoch of the fuser that is not due to a swap.
    fn record_epoch_change(&mut self, epoch: u32) {
        if epoch > self.swaps.fuser_epoch.max(FIRST_EPOCH) {
            self.swaps.fuser_epoch = epoch;
            let newest = self.bus.fused.next_tick + self.config().lateness_ticks();
            self.swaps.fuser_epoch_changes.push(self.collector.sequence.next_tick..=newest);
        }
    }

    /// Records a process that is to take over a slot.
    fn record_candidate(
        &mut self,
        incarnation: u32,
        service: Service,
        stage: Option<&launch::StageConfig>,
        role: Role,
        checkpoint_tick: Option<u64>,
    ) {
        let Some((slot, stage)) = service.slot().zip(stage) else { return };
        let current_stage = &self.supervision.launch().stage(slot).stage;
        let owner = self.supervision.entries().find(|(slot, _)| *slot == service);
        let replaces_exited_owner = role != Role::Candidate;
        // If the process is the current owner, this is a restart and not a take-over.
        if replaces_exited_owner && owner.is_some_and(|(_, entry)| entry.incarnation() == incarnation) {
            return;
        }
        let changes_stage = *current_stage != stage.stage;
        let stage = stage.stage.clone();
        self.swaps.candidates.insert(
            incarnation,
            Candidate {
                service,
                stage,
                changes_stage,
                checkpoint_tick,
                replaces_exited_owner,
                decided_from_tick: None,
            },
        );
    }

    /// Records the candidates that have become owners of their slots.
    fn record_commitments(&mut self) {
        for (service, entry) in self.supervision.entries() {
            let Some(candidate) = self.swaps.candidates.remove(&entry.incarnation()) else { continue };
            self.swaps.count += 1;
            let Candidate { stage, changes_stage, checkpoint_tick, replaces_exited_owner, decided_from_tick, .. } =
                candidate;
            match (checkpoint_tick, decided_from_tick) {
                // The exited owner may have sent different numbers of ticks to different
                // subscribers, so the output may be ambiguous.
                _ if replaces_exited_owner => self.swaps.ambiguous |= changes_stage || checkpoint_tick.is_none(),
                (Some(checkpoint_tick), Some(from_tick)) => {
                    let committed = CommittedSwap { stage, changes_stage, checkpoint_tick, from_tick };
                    self.swaps.committed.entry(service.name()).or_default().push(committed);
                }
                _ => self.swaps.ambiguous = true,
            }
        }
    }

    /// Returns `true` if it is uncertain which stage published which tick.
    pub(crate) fn is_ambiguous(&self) -> bool {
        let published = |candidate: &Candidate| {
            let changes_stage = candidate.changes_stage || candidate.checkpoint_tick.is_none();
            changes_stage && (candidate.replaces_exited_owner || candidate.decided_from_tick.is_some())
        };
        self.swaps.ambiguous || self.swaps.has_ambiguous_swap_flag() || self.swaps.candidates.values().any(published)
    }

    /// Sends a request as a new client.
    pub(crate) fn send_request(&mut self, fault: Fault) {
        let number = self.clients.len() as u64 + 1;
        let description = format!("{fault:?}");
        let mut disconnect_ms = None;
        let request = match fault {
            Fault::Swap { slot, stage: name, shadow_ms, expected_epoch } => {
                disconnect_ms = shadow_ms.map(|ms| self.now_ms + ms);
                let shadow = shadow_ms.is_some();
                let timeout_ms = (!shadow).then_some(SWAP_TIMEOUT_MS);
                let slot = slot.name().into();
                ControlRequest::Swap(SwapRequest { slot, stage: stage(name), shadow, expected_epoch, timeout_ms })
            }
            Fault::Cancel { slot } => ControlRequest::Cancel { slot: slot.name().into() },
            _ => ControlRequest::Status,
        };
        self.clients.insert(number, Client { description, replies: 0, disconnect_ms, disconnected: false });
        self.requests.push_back((number, request));
    }

    /// Disconnects the clients that have reached their disconnect time. This ends their shadows.
    pub(crate) fn disconnect_clients(&mut self) {
        for (number, client) in &mut self.clients {
            let is_due = client.disconnect_ms.is_some_and(|at_ms| self.now_ms >= at_ms);
            if is_due && !client.disconnected && client.replies == 0 {
                client.disconnected = true;
                self.disconnected.push_back(*number);
            }
        }
    }

    /// Checks the result of a finished run.
    pub(crate) fn check(&mut self) -> Result<(), String> {
        self.collector.collect(&mut self.bus, &mut self.random);
        self.collector.finish();
        let ingested_ticks = self.bus.imu.next_tick;
        let attitudes = &self.collector.attitudes;
        if self.setup.strict {
            match &self.finished {
                Some(Some(Failure::FilesUnusableRepeatedly { .. })) => return self.check_replies(),
                Some(Some(failure)) => return Err(format!("stopped with a failure: {failure}")),
                _ => {}
            }
            let expected_ticks = if self.stop_requested { ingested_ticks } else { self.setup.ticks };
            if attitudes.len() as u64 != expected_ticks || self.collector.sequence.lost > 0 {
                let lost = self.collector.sequence.lost;
                let next = self.collector.sequence.next_tick;
                let count = attitudes.len();
                return Err(format!("{count} of {expected_ticks} ticks received, {lost} lost before tick {next}"));
            }
            self.check_bytes()?;
        }
        if self.collector.superseded > 0 {
            return Err(format!("{} attitudes have an older epoch than their predecessor", self.collector.superseded));
        }
        let counted = attitudes.len() as u64 + self.collector.sequence.lost;
        if counted != self.collector.sequence.next_tick || self.collector.sequence.next_tick > ingested_ticks {
            let next = self.collector.sequence.next_tick;
            return Err(format!(
                "{counted} ticks received or lost before tick {next}, {ingested_ticks} published by ingest"
            ));
        }
        self.check_replies()
    }

    /// Compares the output with that of a run without faults, unless the expected output is
    /// ambiguous.
    fn check_bytes(&self) -> Result<(), String> {
        if self.is_ambiguous() {
            return Ok(());
        }
        let with_swaps;
        let expected = if !self.swaps.has_stage_change() {
            &self.reference_run.attitudes
        } else {
            with_swaps = crate::reference::attitudes(self.flight, self.setup.ticks, &self.swaps.committed)?;
            &with_swaps
        };
        let bytes = |output| bytemuck::bytes_of::<messages::AttitudeOutput>(output);
        let pairs = self.collector.attitudes.iter().zip(expected);
        match pairs.into_iter().find(|(got, expected)| bytes(got) != bytes(expected)) {
            Some((got, expected)) => Err(format!(
                "tick {} differs from the reference run with the swaps {:?}:\n{got:?}\n{expected:?}",
                expected.header.tick, self.swaps.committed
            )),
            None => Ok(()),
        }
    }

    fn check_replies(&self) -> Result<(), String> {
        for (number, client) in &self.clients {
            let is_pending = self.requests.iter().any(|(waiting, _)| waiting == number);
            let is_answered = client.replies == 1 || (client.disconnected || is_pending) && client.replies == 0;
            if !is_answered {
                return Err(format!(
                    "request {number}, {}: {} replies instead of one",
                    client.description, client.replies
                ));
            }
        }
        Ok(())
    }
}
