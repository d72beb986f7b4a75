//! The supervisor's shell in a simulated world: what happens is told to its core, and what the core asks for is done.

use std::time::Duration;

use launch::Service;
use messages::Credit;
use runtime::{Role, ServiceConfig, service_config::FIRST_EPOCH};
use supervision::{Action, ControlRequest, Event, Failure, Reply, Spawn, SwapRequest};

use crate::{
    bus::SUPERVISOR,
    flight::{config, stage},
    process::{Body, Process},
    record::{Caller, Candidate},
    reference::Committed,
    setup::Fault,
    world::World,
};

/// How often the supervisor looks whether the files of the bus are there while nobody ends, ms.
const LOOK_MS: u64 = 1000;
/// How long somebody who asks for a swap waits for a tick, ms.
const LIMIT_MS: u64 = 3000;

impl World {
    /// The supervisor opens its topics.
    pub(crate) fn join_bus(&mut self) {
        let bus = &mut self.bus;
        bus.health.read_as(1_000_001, SUPERVISOR, false);
        bus.checkpoint.read_as(1_000_002, SUPERVISOR, false);
        bus.difference.read_as(1_000_003, SUPERVISOR, false);
        bus.control.publish_as(SUPERVISOR);
        bus.credit.publish_as(SUPERVISOR);
    }

    /// One round of the supervisor.
    pub(crate) fn supervise(&mut self) -> Result<(), String> {
        let dead = std::mem::take(&mut self.dead);
        let died = !dead.is_empty();
        let mut events = self.read();
        // Time passes between one look and the next.
        if self.random.happens(200) {
            self.work();
        }
        self.collector.collect(&mut self.bus, &mut self.random);
        events.push(Event::Output(self.collector.progress()));
        for (incarnation, how) in dead {
            events.push(Event::Exited { incarnation, exit_status: how.into(), stderr: String::new() });
        }
        if self.removed && (died || self.now_ms >= self.looked_ms + LOOK_MS) {
            self.looked_ms = self.now_ms;
            events.push(Event::FilesRemoved { path: "/dev/shm/plumbline.simulated".into() });
        }
        let requests = self.requests.drain(..).map(|(caller, request)| Event::Request { client: caller, request });
        events.extend(requests);
        events.extend(self.gone.drain(..).map(|caller| Event::ClientDisconnected { client: caller }));
        if self.end_asked {
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

    /// What the services have said, and how far each has published.
    fn read(&mut self) -> Vec<Event> {
        let Self { bus, random, setup, .. } = self;
        bus.control.deliver_history(SUPERVISOR);
        bus.credit.deliver_history(SUPERVISOR);
        let mut events = Vec::new();
        while let Some(health) = bus.health.receive(1_000_001, random) {
            events.push(Event::Health(health));
        }
        while let Some(mut checkpoint) = bus.checkpoint.receive(1_000_002, random) {
            if random.happens(setup.damaged_per_mille) {
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
        // Who asks once the end has come finds nobody.
        if let (Event::Request { client: caller, request }, true) = (&event, self.finished.is_some()) {
            self.requests.push_back((*caller, request.clone()));
        }
        if let Event::Exited { incarnation, exit_status: how, .. } = &event {
            self.narrate(|_| format!("process {incarnation} {how}"));
        }
        for action in self.supervision.handle(Duration::from_millis(self.now_ms), event) {
            self.act(action)?;
        }
        self.note_commitments();
        Ok(())
    }

    fn act(&mut self, action: Action) -> Result<(), String> {
        // What was asked for before the end came is not done any more; who waits for an answer has it.
        if self.finished.is_some() && !matches!(action, Action::Reply { .. }) {
            return Ok(());
        }
        match action {
            Action::Spawn(spawn) => return self.spawn(*spawn),
            Action::Terminate { incarnation } => {
                self.narrate(|_| format!("asks {incarnation} to end"));
                self.process(incarnation).into_iter().for_each(|process| process.asked = true);
            }
            Action::Kill { incarnation } => {
                self.narrate(|_| format!("kills {incarnation}"));
                self.process(incarnation).into_iter().for_each(|process| process.kill(None));
            }
            Action::PublishControl(control) => {
                self.narrate(|_| format!("{control:?}"));
                if let Some(candidate) = self.swaps.candidates.get_mut(&control.owner) {
                    candidate.decided_from = Some(control.from_tick);
                } else if control.service == Service::Fuser as u32 {
                    self.note_renumbered(control.epoch);
                }
                self.bus.control.send(SUPERVISOR, control, &mut None);
            }
            Action::GrantCredit { ticks, is_final: ends } => {
                self.bus.credit.send(SUPERVISOR, Credit { ticks, ends: ends.into() }, &mut None);
            }
            Action::Reply { client: caller, reply } => {
                self.narrate(|_| match &reply {
                    Reply::Swap(report) => format!("answers {caller}: {report}"),
                    _ => format!("answers {caller}"),
                });
                let Some(caller) = self.callers.get_mut(&caller) else { return Err("nobody asked that".into()) };
                caller.answers += 1;
            }
            Action::PublishEvent(_) => {}
            Action::Announce(line) => self.narrate(|_| format!("says: {line}")),
            Action::Ready => self.narrate(|_| "every service runs".into()),
            Action::Stopping => self.narrate(|_| "the end begins".into()),
            Action::RenewBus => {
                // A stage that has taken over may begin before its first tick there.
                self.swaps.either |= self.swaps.has_swapped() || self.is_undecided();
                self.swaps.fuser_epoch = FIRST_EPOCH;
                self.processes.clear();
                self.dead.clear();
                self.bus = self.bus.renewed();
                self.removed = false;
                let config = self.config();
                self.collector.renew(&mut self.bus, &config);
                self.join_bus();
                return self.handle(Event::BusRenewed);
            }
            Action::Finish(failure) => {
                self.narrate(|_| format!("the end: {failure:?}"));
                self.finished = Some(failure);
            }
        }
        Ok(())
    }

    fn config(&self) -> ServiceConfig {
        let ticks_max = Some(self.setup.ticks);
        ServiceConfig { pace: self.setup.pace, max_ticks: ticks_max, ..config(&self.setup.launch) }
    }

    fn spawn(&mut self, spawn: Spawn) -> Result<(), String> {
        let Spawn { incarnation, service, stage, role, epoch, resume } = spawn;
        let is_first = resume.is_none();
        if let (Service::Fuser, Role::Owner { .. }) = (service, role) {
            self.note_renumbered(epoch);
        }
        // What the former stage had published is made again by the one that has taken over.
        if let (Role::Owner { from_tick }, Some(swaps)) = (role, self.swaps.committed.get(service.name())) {
            self.swaps.either |= swaps.iter().any(|committed| committed.other && from_tick < committed.from_tick);
        }
        // A checkpoint of another stage than fills the slot: none of its own has come yet.
        if let (Some(supervision::Resume::Checkpoint(checkpoint)), Some(fills)) =
            (&resume, self.supervision.launch().stage(service))
        {
            self.swaps.either |= checkpoint.stage() != fills.stage;
        }
        let checkpoint_tick = match &resume {
            Some(supervision::Resume::Checkpoint(checkpoint)) => Some(checkpoint.next_tick),
            Some(supervision::Resume::Source { next_tick, .. }) => Some(*next_tick),
            _ => None,
        };
        self.note_candidate(incarnation, service, stage.as_ref(), role, checkpoint_tick);
        if self.random.happens(self.setup.unspawned_per_mille) && !(is_first && self.setup.strict) {
            self.narrate(|_| format!("{service} {incarnation} cannot be started"));
            return self.handle(Event::SpawnFailed { incarnation, cause: "no such file".into() });
        }
        self.restarts += u64::from(!is_first);
        let mut launch = self.supervision.launch().clone();
        if let Some((slot, stage)) = launch.stage_mut(service).zip(stage) {
            *slot = stage;
        }
        let resume = resume.map(resume_of);
        let config = ServiceConfig { launch, incarnation, epoch, role, resume, ..self.config() };
        let candidate = role == Role::Candidate;
        let hangs = self.random.happens(self.setup.hang_per_mille) && !(is_first && self.setup.strict);
        let dies = self.random.happens(self.setup.mute_per_mille) && !(is_first && self.setup.strict);
        let wake_ms = self.now_ms + self.random.between(1, self.setup.start_ms);
        let flawed = candidate && self.random.happens(self.setup.flawed_per_mille);
        self.narrate(|_| format!("{service} {incarnation} starts: {role:?} of {epoch}, from {checkpoint_tick:?}"));
        self.processes.push(Process {
            incarnation,
            service,
            candidate,
            body: if hangs { Body::Deaf } else { Body::Starting { config: Box::new(config), dies } },
            wake_ms,
            frozen_until_ms: 0,
            asked: false,
            deliveries: None,
            flawed_from: flawed.then(|| self.bus.imu.next_tick + self.random.between(0, 60)),
            how: None,
        });
        self.handle(Event::Spawned { incarnation, pid: incarnation })
    }

    fn process(&mut self, incarnation: u32) -> Option<&mut Process> {
        self.processes.iter_mut().find(|process| process.incarnation == incarnation)
    }

    /// Notes a decision about the fuser that is no commitment.
    fn note_renumbered(&mut self, epoch: u32) {
        if epoch > self.swaps.fuser_epoch.max(FIRST_EPOCH) {
            self.swaps.fuser_epoch = epoch;
            let newest = self.bus.fused.next_tick + self.config().lateness_ticks();
            self.swaps.renumbered.push(self.collector.sequence.next_tick..=newest);
        }
    }

    /// Notes a process that is to take over.
    fn note_candidate(
        &mut self,
        incarnation: u32,
        service: Service,
        stage: Option<&launch::StageConfig>,
        role: Role,
        checkpoint_tick: Option<u64>,
    ) {
        let Some(stage) = stage else { return };
        let fills = self.supervision.launch().stage(service).map(|slot| slot.stage.clone());
        let owned = self.supervision.entries().find(|(other, _)| *other == service);
        let alone = role != Role::Candidate;
        // Who is started again in its own slot takes nothing over.
        if alone && owned.is_some_and(|(_, entry)| entry.incarnation() == incarnation) {
            return;
        }
        let other = fills.as_ref() != Some(&stage.stage);
        let stage = stage.stage.clone();
        self.swaps
            .candidates
            .insert(incarnation, Candidate { service, stage, other, checkpoint_tick, alone, decided_from: None });
    }

    /// Sees which candidates own their slots by now.
    fn note_commitments(&mut self) {
        for (service, entry) in self.supervision.entries() {
            let Some(candidate) = self.swaps.candidates.remove(&entry.incarnation()) else { continue };
            self.swaps.count += 1;
            let Candidate { stage, other, checkpoint_tick, alone, decided_from, .. } = candidate;
            match (checkpoint_tick, decided_from) {
                // Readers may have had more or less of the one that ended.
                _ if alone => self.swaps.either |= other || checkpoint_tick.is_none(),
                (Some(checkpoint_tick), Some(from_tick)) => {
                    let committed = Committed { stage, other, checkpoint_tick, from_tick };
                    self.swaps.committed.entry(service.name()).or_default().push(committed);
                }
                _ => self.swaps.either = true,
            }
        }
    }

    /// Whether ticks may have come of a stage that has not taken over in the end.
    pub(crate) fn is_undecided(&self) -> bool {
        let published = |candidate: &Candidate| {
            let other = candidate.other || candidate.checkpoint_tick.is_none();
            other && (candidate.alone || candidate.decided_from.is_some())
        };
        self.swaps.either || self.swaps.is_mistakable() || self.swaps.candidates.values().any(published)
    }

    /// Somebody asks.
    pub(crate) fn ask(&mut self, what: Fault) {
        let number = self.callers.len() as u64 + 1;
        let text = format!("{what:?}");
        let mut leaves_ms = None;
        let request = match what {
            Fault::Swap { service, stage: name, shadow_ms, expected_epoch } => {
                leaves_ms = shadow_ms.map(|ms| self.now_ms + ms);
                let shadow = shadow_ms.is_some();
                let limit_ms = (!shadow).then_some(LIMIT_MS);
                let slot = service.name().into();
                ControlRequest::Swap(SwapRequest { slot, stage: stage(name), shadow, expected_epoch, timeout_ms: limit_ms })
            }
            Fault::Cancel { service } => ControlRequest::Cancel { slot: service.name().into() },
            _ => ControlRequest::Status,
        };
        self.callers.insert(number, Caller { what: text, answers: 0, leaves_ms, gone: false });
        self.requests.push_back((number, request));
    }

    /// Who asked for a shadow goes away after its time.
    pub(crate) fn callers_leave(&mut self) {
        for (number, caller) in &mut self.callers {
            if !caller.gone && caller.answers == 0 && caller.leaves_ms.is_some_and(|at_ms| self.now_ms >= at_ms) {
                caller.gone = true;
                self.gone.push_back(*number);
            }
        }
    }

    /// What must hold at the end.
    pub(crate) fn check(&mut self) -> Result<(), String> {
        self.collector.collect(&mut self.bus, &mut self.random);
        self.collector.finish();
        let ticks_in = self.bus.imu.next_tick;
        let taken = &self.collector.taken;
        if self.setup.strict {
            match &self.finished {
                Some(Some(Failure::FilesRemovedRepeatedly { .. })) => return self.check_answers(),
                Some(Some(failure)) => return Err(format!("it ended: {failure}")),
                _ => {}
            }
            let at_end = if self.end_asked { ticks_in } else { self.setup.ticks };
            if taken.len() as u64 != at_end || self.collector.sequence.lost > 0 {
                let lost = self.collector.sequence.lost;
                let next = self.collector.sequence.next_tick;
                return Err(format!("{} of {at_end} ticks came out, {lost} lost on the way to {next}", taken.len()));
            }
            self.check_bytes()?;
        }
        if self.collector.superseded > 0 {
            return Err(format!("{} attitudes are of an older decision than one before", self.collector.superseded));
        }
        let counted = taken.len() as u64 + self.collector.sequence.lost;
        if counted != self.collector.sequence.next_tick || self.collector.sequence.next_tick > ticks_in {
            return Err(format!("{counted} ticks are accounted for, {ticks_in} came in"));
        }
        self.check_answers()
    }

    fn check_bytes(&self) -> Result<(), String> {
        if self.is_undecided() {
            return Ok(());
        }
        let own;
        let expected = if !self.swaps.has_swapped() {
            &self.undisturbed.attitudes
        } else {
            own = crate::reference::attitudes(self.flight, self.setup.ticks, &self.swaps.committed)?;
            &own
        };
        let bytes = |output| bytemuck::bytes_of::<messages::AttitudeOutput>(output);
        let pairs = self.collector.taken.iter().zip(expected);
        match pairs.into_iter().find(|(got, expected)| bytes(got) != bytes(expected)) {
            Some((got, expected)) => Err(format!(
                "tick {} is another than in an undisturbed run with {:?}:\n{got:?}\n{expected:?}",
                expected.header.tick, self.swaps.committed
            )),
            None => Ok(()),
        }
    }

    fn check_answers(&self) -> Result<(), String> {
        for (number, caller) in &self.callers {
            let untold = self.requests.iter().any(|(waiting, _)| waiting == number);
            let answered = caller.answers == 1 || (caller.gone || untold) && caller.answers == 0;
            if !answered {
                return Err(format!("request {number}, {}, was answered {} times", caller.what, caller.answers));
            }
        }
        Ok(())
    }
}

/// The same as a service is told.
fn resume_of(resume: supervision::Resume) -> runtime::service_config::Resume {
    use runtime::service_config::Resume;
    match resume {
        supervision::Resume::Fresh => Resume::Fresh,
        supervision::Resume::Checkpoint(checkpoint) => Resume::Checkpoint(Box::new((&*checkpoint).into())),
        supervision::Resume::Source { next_tick, start_ns, offset_ns } => {
            Resume::Source { next_tick, start_ns, offset_ns }
        }
    }
}
