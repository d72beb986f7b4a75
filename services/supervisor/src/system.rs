//! The services as processes on the bus: what happens is told to [`Supervision`], and what it asks for is done.

mod attached;
mod recorded;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{Claim, SharedMemory, SystemName};
use launch::Service;
use messages::{Credit, EventKind, SystemEvent};
use pipeline::{Collector, OutFile};
use runtime::{Role, ServiceConfig, clock::monotonic_ns};
use rustix::process::Signal;
use supervision::{Action, Config, Event, OutputProgress, RecordStatus, Reply, Spawn, Supervision};

use crate::{
    Plan, Report, UpError,
    flight::beginning,
    input::InputJudge,
    notify::Notifier,
    processes::{Processes, own_cpu_s},
    recorder::Recorder,
    report::{Account, ServiceReport},
    scheduling::{self, SchedulingClass},
    view::View,
    warm::WarmStart,
};
use attached::{Attached, Reads};

/// How often people see something new.
const VIEW_INTERVAL: Duration = Duration::from_millis(100);
/// Between two looks whether the files of the bus are there while nobody ends.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);

/// Runs the plan as processes, and has them recorded.
pub fn run(plan: &Plan, asked_to_end: Arc<AtomicBool>, recorder: Option<&mut dyn Recorder>) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_ref())?;
    let mut system = System::start(plan, asked_to_end, recorder)?;
    let failure = system.run(&mut collector).err();
    let mut report = system.report(collector, failure);
    if let Some(recorder) = system.end() {
        report.record(recorder.end(&report));
    }
    Ok(report)
}

/// A running system. Its fields are dropped in this order: processes, bus, and last the name.
struct System<'r> {
    processes: Processes,
    /// `None` while there is none, and where no new one could be made.
    attached: Option<Attached>,
    reads: Reads,
    supervision: Supervision,
    started: Instant,
    /// What every service is told.
    config: ServiceConfig,
    warm: WarmStart,
    view: View,
    notifier: Notifier,
    asked_to_end: Arc<AtomicBool>,
    cost: Cost,
    judge: InputJudge,
    /// Events told.
    events: u64,
    recorder: Option<&'r mut dyn Recorder>,
    /// That the recording has ended before its time is said once.
    recording_ended: bool,
    looked: Instant,
    shown: Instant,
    finished: Option<Result<(), UpError>>,
    claim: Option<Claim>,
}

/// What the processes cost, from when every one was ready until the first was asked to end.
struct Cost {
    since: Instant,
    cpu_since_s: f64,
    cpu_s_per_s: Option<f64>,
}

impl<'r> System<'r> {
    fn start(
        plan: &Plan,
        asked_to_end: Arc<AtomicBool>,
        mut recorder: Option<&'r mut dyn Recorder>,
    ) -> Result<Self, UpError> {
        let notifier = Notifier::new()?;
        let system_name = SystemName::new(&plan.config.launch.name)?;
        SharedMemory::suffices(system_name.name(), plan.config.shared_memory_bytes())?;
        let claim = system_name.claim()?;
        // All topics of its own are open before a service starts: to wait for one that a service is just making is what a signal would
        // break off.
        let reads = Reads {
            fused: plan.out.as_ref().is_some_and(OutFile::needs_fused),
            every_topic: recorder.is_some(),
            input: true,
        };
        let attached = Attached::open(&system_name, &plan.config, 0, reads)?;
        let view = View::new(plan)?;
        let (warm, prior) = WarmStart::begin(plan)?;
        if let Some(recorder) = &mut recorder {
            recorder.begin(&plan.config)?;
        }
        scheduling::set_own();
        let mut system = Self {
            processes: Processes::default(),
            attached: Some(attached),
            reads,
            supervision: Supervision::new(decisions(plan), Duration::ZERO),
            started: Instant::now(),
            config: ServiceConfig { prior, ..plan.config.clone() },
            warm,
            view,
            notifier,
            asked_to_end,
            cost: Cost { since: Instant::now(), cpu_since_s: 0.0, cpu_s_per_s: None },
            judge: InputJudge::default(),
            events: 0,
            recorder,
            recording_ended: false,
            looked: Instant::now(),
            shown: Instant::now(),
            finished: None,
            claim: Some(claim),
        };
        let Plan { config, .. } = plan;
        system.tell(beginning(config.rate_hz, &config.launch));
        if let Some(prior) = prior {
            system.tell(SystemEvent::new(EventKind::WARM).with_stage("", prior.numbers()));
        }
        Ok(system)
    }

    /// Runs to the end.
    fn run(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        self.handle(Event::Time, collector)?;
        loop {
            if let Some(finished) = self.finished.take() {
                self.notifier.stopping();
                return finished;
            }
            self.wait();
            self.round(collector)?;
            if self.shown.elapsed() > VIEW_INTERVAL && self.supervision.is_running() {
                self.shown = Instant::now();
                self.view.show(collector, Some(&self.supervision), self.started.elapsed());
            }
        }
    }

    /// Tells what has happened since the last time.
    fn round(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let exits = self.processes.reap();
        let died = !exits.is_empty();
        let Some(attached) = &mut self.attached else { return Ok(()) };
        // Checkpoints before attitudes: what was published before a checkpoint has then been taken.
        let mut events = attached.read()?;
        if self.supervision.published_elsewhere().is_none() {
            attached.collect(collector)?;
        }
        // Before the source has leave to go on.
        if let Some((recorded, recorder)) = attached.recorded.as_ref().zip(self.recorder.as_mut()) {
            recorded.look(&mut **recorder);
        }
        events.push(Event::Output(progress(collector)));
        events.extend(exits.into_iter().map(Event::from));
        if died {
            attached.reaper.note_death();
        }
        for event in events {
            self.handle(event, collector)?;
        }
        self.judge_input();
        self.look(died, collector)?;
        self.answer_callers(collector)?;
        if self.asked_to_end.load(Ordering::SeqCst) {
            self.handle(Event::EndAsked, collector)?;
        }
        self.handle(Event::Time, collector)?;
        self.notifier.flowing(self.supervision.next_tick());
        let lines = self.warm.keep_newest(self.supervision.newest_checkpoint(Service::Fuser));
        self.view.announce(lines);
        if let Some(failure) = self.recording_failure().filter(|_| !self.recording_ended) {
            self.recording_ended = true;
            self.view.announce([failure]);
        }
        Ok(())
    }

    /// Why the flight is recorded no more.
    fn recording_failure(&self) -> Option<String> {
        self.recorder.as_ref().and_then(|recorder| recorder.failure())
    }

    /// Sees whether somebody has removed files of the bus: now and then, and whenever a process has died.
    fn look(&mut self, died: bool, collector: &mut Collector) -> Result<(), UpError> {
        let Some(claim) = self.claim.as_ref().filter(|_| died || self.looked.elapsed() >= LOOK_INTERVAL) else {
            return Ok(());
        };
        self.looked = Instant::now();
        let services = self.supervision.entries().filter_map(|(_, entry)| entry.pid()).filter(|_| died);
        let pids: Vec<_> = services.chain([std::process::id()]).collect();
        match claim.system_name().removed(&pids) {
            Some(path) => self.handle(Event::FilesRemoved { path }, collector),
            None => Ok(()),
        }
    }

    fn answer_callers(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let Some(attached) = &mut self.attached else { return Ok(()) };
        let requests = attached.socket.requests();
        let departed = attached.socket.departed();
        for (caller, request) in requests {
            self.handle(Event::Request { caller, request }, collector)?;
        }
        for caller in departed {
            self.handle(Event::CallerGone { caller }, collector)?;
        }
        Ok(())
    }

    /// Tells an event, and does what is asked for.
    fn handle(&mut self, event: Event, collector: &mut Collector) -> Result<(), UpError> {
        for action in self.supervision.handle(self.started.elapsed(), event) {
            self.act(action, collector)?;
        }
        Ok(())
    }

    fn act(&mut self, action: Action, collector: &mut Collector) -> Result<(), UpError> {
        // What was asked for before the end came is not done any more; who waits for an answer has it.
        if self.finished.is_some() && !matches!(action, Action::Answer { .. }) {
            return Ok(());
        }
        match action {
            Action::Spawn(spawn) => {
                let incarnation = spawn.incarnation;
                let event = match self.spawn(*spawn) {
                    Ok(pid) => Event::Spawned { incarnation, pid },
                    Err(cause) => Event::SpawnFailed { incarnation, cause },
                };
                return self.handle(event, collector);
            }
            Action::Terminate { incarnation } => {
                self.processes.schedule(incarnation, SchedulingClass::Leaving);
                self.processes.signal(incarnation, Signal::TERM);
            }
            Action::Kill { incarnation } => self.processes.signal(incarnation, Signal::KILL),
            Action::PublishControl(control) => {
                self.processes.schedule(control.owner, SchedulingClass::Path);
                self.attached.iter().for_each(|attached| attached.publish(&control));
            }
            Action::GrantCredit { ticks, ends } => {
                self.attached
                    .as_ref()
                    .map_or(Ok(()), |attached| attached.grant(Credit { ticks, ends: ends.into() }))?;
            }
            Action::Answer { caller, reply } => self.answer(caller, &reply, collector),
            Action::Tell(event) => self.tell(*event),
            Action::Announce(line) => self.view.announce([line]),
            Action::Ready => {
                self.notifier.ready();
                if self.cost.cpu_since_s == 0.0 {
                    (self.cost.since, self.cost.cpu_since_s) = (Instant::now(), own_cpu_s() + self.processes.cpu_s());
                }
            }
            Action::Stopping => {
                self.notifier.stopping();
                // Before the first process is reaped, and its time with it.
                self.cost.cpu_s_per_s = Some(self.cpu_s_per_s());
            }
            Action::RenewBus => {
                self.renew(collector.next_tick())?;
                return self.handle(Event::BusRenewed, collector);
            }
            Action::Finish(failure) => self.finished = Some(failure.map_or(Ok(()), |failure| Err(failure.into()))),
        }
        Ok(())
    }

    /// Publishes an event, whether or not anybody listens.
    fn tell(&mut self, event: SystemEvent) {
        let number = self.events;
        self.events += 1;
        if let Some(attached) = &self.attached {
            attached.tell(&SystemEvent { number, t_told_ns: monotonic_ns(), ..event });
        }
    }

    fn spawn(&mut self, spawn: Spawn) -> Result<u32, String> {
        let Spawn { incarnation, service, stage, role, epoch, resume } = spawn;
        let launch = self.supervision.launch().clone();
        let resume = resume.map(resume_of);
        let mut config = ServiceConfig { launch, incarnation, epoch, role, resume, ..self.config.clone() };
        if let Some((slot, stage)) = config.launch.slot_mut(service).zip(stage) {
            *slot = stage;
        }
        let class = match role {
            _ if service.can_wait() => SchedulingClass::Beside,
            Role::Owner { .. } => SchedulingClass::Path,
            Role::Candidate => SchedulingClass::Starting,
        };
        self.processes.start(service, &config, class)
    }

    fn answer(&mut self, caller: u64, reply: &Reply, collector: &Collector) {
        let recording_failure = self.recording_failure();
        let Some(attached) = &mut self.attached else { return };
        let socket = &mut attached.socket;
        match reply {
            Reply::Swap(report) => socket.answer(caller, report),
            Reply::Status(status) => socket.answer(caller, status),
            Reply::ServiceConfig => {
                socket.answer(
                    caller,
                    &ServiceConfig { launch: self.supervision.launch().clone(), ..self.config.clone() },
                );
            }
            Reply::Record => {
                let out_ended = collector.out_ended().map(ToString::to_string);
                let out_ended = out_ended.or(recording_failure);
                socket.answer(caller, &RecordStatus { not_recorded: collector.not_recorded(), out_ended });
            }
            Reply::Done => socket.answer(caller, &()),
        }
    }

    /// Another bus of the name, in the place of one whose files somebody has removed; `next_tick` comes out next.
    fn renew(&mut self, next_tick: u64) -> Result<(), UpError> {
        self.processes.kill();
        // What was open on the old bus is closed first: its topics have the names of the new ones.
        self.attached = None;
        let Some(claim) = self.claim.take() else { return Ok(()) };
        let claim = self.claim.insert(claim.renew()?);
        self.reads.input = !self.judge.is_ended();
        self.attached = Some(Attached::open(claim.system_name(), &self.config, next_tick, self.reads)?);
        Ok(())
    }

    /// In lockstep the source waits for the attitude to be taken, so that wakes this; else it looks from time to time, and when a service
    /// ends.
    fn wait(&self) {
        let limit = self.supervision.poll_interval();
        match &self.attached {
            Some(attached) if self.supervision.waits_for_output() => attached.wait(limit),
            _ => self.processes.wait(limit),
        }
    }

    /// Judges what has come in, until the verdict.
    fn judge_input(&mut self) {
        let Some(attached) = &mut self.attached else { return };
        let warnings = attached.input.as_mut().map_or(Vec::new(), |input| input.look(&mut self.judge));
        attached.input.take_if(|_| self.judge.is_ended());
        self.view.announce(warnings);
    }

    /// How it went, to the end or to what ended it.
    fn report(&mut self, mut collector: Collector, failure: Option<UpError>) -> Report {
        let cpu_s_per_s = self.cost.cpu_s_per_s.unwrap_or_else(|| self.cpu_s_per_s());
        let mut failure = failure;
        if let Some(attached) = &self.attached {
            if self.supervision.published_elsewhere().is_none() {
                failure = failure.or(attached.collect(&mut collector).err());
            }
            // What waits for ticks that have not come is counted with them as lost.
            attached.finish(&mut collector);
            if let Some((recorded, recorder)) = attached.recorded.as_ref().zip(self.recorder.as_mut()) {
                recorded.look(&mut **recorder);
            }
        }
        let ingest = self.attached.as_ref().filter(|_| self.supervision.launch().origin() == Service::Ingest);
        let published = ingest.map_or(0, |attached| attached.published(Service::Ingest));
        let services = self.supervision.entries().map(|(service, entry)| ServiceReport {
            name: service.name(),
            pid: entry.pid(),
            restarts: entry.restarts(),
        });
        let warnings = self.judge.finish();
        self.view.announce(warnings);
        let account = Account {
            warnings: std::mem::take(&mut self.judge).into_warnings(),
            ticks_in: self.supervision.ticks_in().max(published),
            ticks_out: self.supervision.published_elsewhere(),
            refused: self.supervision.refused(),
            cpu_s_per_s,
            services: services.collect(),
        };
        Report::new(collector, account, failure)
    }

    fn cpu_s_per_s(&self) -> f64 {
        let Cost { since, cpu_since_s, .. } = self.cost;
        (own_cpu_s() + self.processes.cpu_s() - cpu_since_s).max(0.0) / since.elapsed().as_secs_f64()
    }

    /// Ends what is left; gives back who recorded it.
    fn end(mut self) -> Option<&'r mut dyn Recorder> {
        self.processes.end();
        let lines = self.warm.end(self.supervision.newest_checkpoint(Service::Fuser));
        self.view.announce(lines);
        self.view.end();
        self.recorder
    }
}

/// What the supervision of a plan is told.
fn decisions(plan: &Plan) -> Config {
    let config = &plan.config;
    Config {
        launch: config.launch.clone(),
        rate_hz: config.rate_hz,
        lockstep: config.lockstep(),
        window_ticks: config.window_ticks(),
        buffer_ticks: config.buffer_ticks() as u64,
        stop_after: plan.stop_after_s.map(Duration::from_secs_f64),
        validate: crate::plan::validate,
    }
}

fn progress(collector: &mut Collector) -> OutputProgress {
    OutputProgress {
        next_tick: collector.next_tick(),
        lost: collector.lost(),
        not_taken: collector.not_recorded(),
        duplicated: collector.duplicated(),
        gap_ns: collector.take_gap_ns(),
        swapped: collector.swapped(),
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
