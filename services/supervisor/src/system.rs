//! Runs the services as processes on the bus: passes events to [`Supervision`] and performs its
//! actions.

mod connection;
mod recorded_topics;

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{BusError, Claim, FileMonitor, SharedMemory, SystemName};
use control::RecordStatus;
use flight::Recorder;
use launch::{Service, TickSource};
use messages::{Credit, EventKind, SystemEvent};
use pipeline::{AttitudeFile, Collector};
use runtime::{Role, ServiceConfig, clock::monotonic_ns};
use rustix::process::Signal;
use supervision::{Action, Config, Event, FileFault, OutputProgress, Reply, Spawn, Supervision};

use crate::{
    Plan, Report, Request,
    error::UpError,
    input::InputChecker,
    last_run::RunRecord,
    notify::Notifier,
    processes::{Processes, own_cpu_s},
    recorder,
    replayed_flight::start_event,
    report::{RunTotals, ServiceReport},
    scheduling::{self, SchedulingClass},
    view::View,
    warm::WarmStart,
};
use connection::{BusConnection, OptionalInputs};

/// Interval between two updates of the display.
const VIEW_INTERVAL: Duration = Duration::from_millis(100);
/// Interval at which services that wait for an idle topic are woken. It is shorter than the
/// interval of health reports of an owner.
const IDLE_WAKE_INTERVAL: Duration = Duration::from_millis(50);
/// Interval between two checks of the bus files and of the control socket while no process exits.
const FILE_CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Runs the plan of `request` as processes and records it, if requested.
///
/// # Errors
///
/// Returns an error if the system could not be started. Later failures are part of the report.
pub fn run(plan: &Plan, request: &Request, stop_requested: Arc<AtomicBool>) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_ref())?;
    let mut system = System::start(plan, request, stop_requested)?;
    let failure = system.run(&mut collector).err();
    if let Some(record) = system.run_record.take() {
        record.finish(failure.as_ref().map(ToString::to_string));
    }
    let mut report = system.report(collector, failure);
    if let Some(recorder) = system.finish() {
        report.set_recording(recorder::finish(recorder, &report));
    }
    Ok(report)
}

/// Running system. The fields are dropped in this order: processes, bus, and finally the system
/// name.
struct System {
    processes: Processes,
    /// Connection to the bus; `None` if a new bus could not be created.
    connection: Option<BusConnection>,
    optional_inputs: OptionalInputs,
    supervision: Supervision,
    started: Instant,
    /// Configuration common to all services.
    config: ServiceConfig,
    warm: WarmStart,
    view: View,
    notifier: Notifier,
    stop_requested: Arc<AtomicBool>,
    cpu_usage: CpuUsage,
    checker: InputChecker,
    /// Number of published events.
    event_count: u64,
    recorder: Option<Recorder>,
    /// Set once the failure of the recording has been announced.
    recording_failure_announced: bool,
    file_monitor: FileMonitor,
    /// Record of this run; `None` without a writable state folder.
    run_record: Option<RunRecord>,
    /// Set once a failure to open the control socket again has been announced.
    socket_failure_announced: bool,
    last_file_check: Instant,
    last_idle_wake: Instant,
    last_shown: Instant,
    finished: Option<Result<(), UpError>>,
    claim: Option<Claim>,
}

/// CPU usage of the processes from the time when every service was ready until shutdown.
struct CpuUsage {
    since: Instant,
    cpu_since_s: f64,
    cpu_s_per_s: Option<f64>,
}

impl System {
    fn start(plan: &Plan, request: &Request, stop_requested: Arc<AtomicBool>) -> Result<Self, UpError> {
        let notifier = Notifier::new()?;
        let system_name = SystemName::new(&plan.config.launch.name)?;
        SharedMemory::check(system_name.name(), plan.config.shared_memory_bytes())?;
        let claim = system_name.claim()?;
        // All of the supervisor's topics are opened before any service starts. Otherwise a signal
        // could interrupt the wait for a topic that a service is still creating.
        let optional_inputs = OptionalInputs {
            fused: plan.out.as_ref().is_some_and(AttitudeFile::needs_fused),
            every_topic: request.record.is_some(),
            input: true,
        };
        let connection = BusConnection::open(&system_name, &plan.config, 0, optional_inputs)?;
        let view = View::new(plan)?;
        let (warm, prior) = WarmStart::load(plan)?;
        let record = |folder: &PathBuf| recorder::create(folder, request, &plan.config);
        let recorder = request.record.as_ref().map(record).transpose()?;
        scheduling::set_supervisor_slice();
        let mut system = Self {
            processes: Processes::default(),
            connection: Some(connection),
            optional_inputs,
            supervision: Supervision::new(supervision_config(plan), Duration::ZERO),
            started: Instant::now(),
            config: ServiceConfig { prior, ..plan.config.clone() },
            warm,
            view,
            notifier,
            stop_requested,
            cpu_usage: CpuUsage { since: Instant::now(), cpu_since_s: 0.0, cpu_s_per_s: None },
            checker: InputChecker::default(),
            event_count: 0,
            recorder,
            recording_failure_announced: false,
            file_monitor: FileMonitor::default(),
            run_record: RunRecord::create(&plan.config.launch.name),
            socket_failure_announced: false,
            last_file_check: Instant::now(),
            last_idle_wake: Instant::now(),
            last_shown: Instant::now(),
            finished: None,
            claim: Some(claim),
        };
        let Plan { config, .. } = plan;
        system.publish_event(start_event(config.rate_hz, &config.launch));
        if let Some(prior) = prior {
            system.publish_event(SystemEvent::new(EventKind::WARM).with_stage("", prior.named_values()));
        }
        Ok(system)
    }

    /// Runs the system to completion.
    fn run(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        self.handle(Event::Timer, collector)?;
        loop {
            if let Some(finished) = self.finished.take() {
                self.notifier.notify_stopping();
                return finished;
            }
            self.wait();
            self.poll_round(collector)?;
            if self.last_shown.elapsed() > VIEW_INTERVAL && self.supervision.is_running() {
                self.last_shown = Instant::now();
                self.view.show(collector, Some(&self.supervision), self.started.elapsed());
            }
        }
    }

    /// Passes everything that has happened since the previous round to [`Supervision`].
    fn poll_round(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let exits = self.processes.reap();
        let has_exits = !exits.is_empty();
        let Some(connection) = &mut self.connection else { return Ok(()) };
        if self.last_idle_wake.elapsed() >= IDLE_WAKE_INTERVAL {
            self.last_idle_wake = Instant::now();
            connection.wake_idle();
        }
        // Checkpoints are read before attitudes, so that all attitudes published before a
        // checkpoint are collected.
        let mut events = connection.poll_events()?;
        if self.supervision.local_next_tick().is_none() {
            connection.collect(collector)?;
        }
        // The recorder reads before the source receives new credit. In lockstep, no message of a
        // round can therefore be overwritten before it is recorded.
        if let Some((topics, recorder)) = connection.recorded.as_ref().zip(self.recorder.as_mut()) {
            topics.poll(recorder);
        }
        events.push(Event::Output(output_progress(collector)));
        events.extend(exits.into_iter().map(Event::from));
        if has_exits {
            connection.wake_after_exit();
            connection.reaper.notify_exit();
        }
        for event in events {
            self.handle(event, collector)?;
        }
        self.check_input();
        self.check_bus_files(has_exits, collector)?;
        self.handle_clients(collector)?;
        if self.stop_requested.load(Ordering::SeqCst) {
            self.handle(Event::StopRequested, collector)?;
        }
        self.handle(Event::Timer, collector)?;
        self.notifier.feed_watchdog(self.supervision.next_tick());
        let lines = self.warm.update(self.supervision.newest_checkpoint(Service::Fuser));
        self.view.announce(lines);
        if let Some(failure) = self.recording_failure().filter(|_| !self.recording_failure_announced) {
            self.recording_failure_announced = true;
            self.view.announce([failure]);
        }
        Ok(())
    }

    /// Returns the reason why the recording failed. `None` if it has not failed or nothing is
    /// recorded.
    fn recording_failure(&self) -> Option<String> {
        self.recorder.as_ref()?.failure().map(str::to_owned)
    }

    /// Checks periodically, and whenever a process has exited, if files of the bus were removed or
    /// damaged. Opens the control socket again if it was removed or replaced.
    fn check_bus_files(&mut self, has_exits: bool, collector: &mut Collector) -> Result<(), UpError> {
        let Some(claim) =
            self.claim.as_ref().filter(|_| has_exits || self.last_file_check.elapsed() >= FILE_CHECK_INTERVAL)
        else {
            return Ok(());
        };
        self.last_file_check = Instant::now();
        self.run_record.iter_mut().for_each(RunRecord::refresh);
        let services = self.supervision.entries().filter_map(|(_, entry)| entry.pid()).filter(|_| has_exits);
        let pids: Vec<_> = services.chain([std::process::id()]).collect();
        let system_name = claim.system_name();
        if !claim.has_intact_state() {
            return Err(BusError::SharedStateDamaged { path: system_name.shared_state_path() }.into());
        }
        let removed = self.file_monitor.removed_file(system_name, &pids, has_exits);
        let removed = removed.map(|path| (path, FileFault::Removed));
        let damaged = || Some((self.file_monitor.damaged_file(system_name)?, FileFault::Damaged));
        if let Some((path, fault)) = removed.or_else(damaged) {
            return self.handle(Event::FilesUnusable { path, fault }, collector);
        }
        if let Some(connection) = &mut self.connection {
            match connection.socket.reopen_if_missing(system_name) {
                Ok(false) => {}
                Ok(true) => self.view.announce(["the control socket was removed or replaced; it is open again".into()]),
                Err(error) if !std::mem::replace(&mut self.socket_failure_announced, true) => {
                    self.view.announce([error.to_string()]);
                }
                Err(_) => {}
            }
        }
        Ok(())
    }

    fn handle_clients(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let Some(connection) = &mut self.connection else { return Ok(()) };
        let requests = connection.socket.poll_requests();
        let disconnected = connection.socket.take_disconnected();
        for (client, request) in requests {
            self.handle(Event::Request { client, request }, collector)?;
        }
        for client in disconnected {
            self.handle(Event::ClientDisconnected { client }, collector)?;
        }
        Ok(())
    }

    /// Passes an event to [`Supervision`] and performs the resulting actions.
    fn handle(&mut self, event: Event, collector: &mut Collector) -> Result<(), UpError> {
        for action in self.supervision.handle(self.started.elapsed(), event) {
            self.perform(action, collector)?;
        }
        Ok(())
    }

    fn perform(&mut self, action: Action, collector: &mut Collector) -> Result<(), UpError> {
        // Once the system has ended, all actions except replies are ignored.
        if self.finished.is_some() && !matches!(action, Action::Reply { .. }) {
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
            Action::Kill { incarnation } => self.processes.kill(incarnation),
            Action::PublishControl(control) => {
                self.processes.schedule(control.owner, SchedulingClass::Path);
                self.connection.iter().for_each(|connection| connection.publish_control(&control));
            }
            Action::GrantCredit { ticks, is_final } => {
                self.connection
                    .as_ref()
                    .map_or(Ok(()), |connection| connection.publish_credit(Credit { ticks, ends: is_final.into() }))?;
            }
            Action::Reply { client, reply } => self.reply(client, &reply, collector),
            Action::PublishEvent(event) => self.publish_event(*event),
            Action::Announce(line) => self.view.announce([line]),
            Action::Ready => {
                self.notifier.notify_ready();
                if self.cpu_usage.cpu_since_s == 0.0 {
                    (self.cpu_usage.since, self.cpu_usage.cpu_since_s) =
                        (Instant::now(), own_cpu_s() + self.processes.cpu_s());
                }
            }
            Action::Stopping => {
                self.notifier.notify_stopping();
                // The CPU usage is measured before the first process is reaped.
                self.cpu_usage.cpu_s_per_s = Some(self.cpu_s_per_s());
            }
            Action::RenewBus => {
                self.renew_bus(collector.next_tick())?;
                return self.handle(Event::BusRenewed, collector);
            }
            Action::Finish(failure) => self.finished = Some(failure.map_or(Ok(()), |failure| Err(failure.into()))),
        }
        Ok(())
    }

    /// Sets the number and the time of an event, and publishes the event if the bus is available.
    fn publish_event(&mut self, event: SystemEvent) {
        let number = self.event_count;
        self.event_count += 1;
        if let Some(connection) = &self.connection {
            connection.publish_event(&SystemEvent { number, t_event_ns: monotonic_ns(), ..event });
        }
    }

    fn spawn(&mut self, spawn: Spawn) -> Result<u32, String> {
        let Spawn { incarnation, service, stage, role, epoch, resume } = spawn;
        let launch = self.supervision.launch().clone();
        let mut config = ServiceConfig { launch, incarnation, epoch, role, resume, ..self.config.clone() };
        if let Some((slot, stage)) = service.slot().zip(stage) {
            *config.launch.stage_mut(slot) = stage;
        }
        let class = match role {
            _ if service.is_low_priority() => SchedulingClass::Auxiliary,
            Role::Owner { .. } => SchedulingClass::Path,
            Role::Candidate => SchedulingClass::Starting,
        };
        self.processes.start(service, &config, class)
    }

    fn reply(&mut self, client: u64, reply: &Reply, collector: &Collector) {
        let recording_failure = self.recording_failure();
        let Some(connection) = &mut self.connection else { return };
        let socket = &mut connection.socket;
        match reply {
            Reply::Swap(report) => socket.respond(client, report),
            Reply::Status(status) => socket.respond(client, status),
            Reply::ServiceConfig => {
                socket.respond(
                    client,
                    &ServiceConfig { launch: self.supervision.launch().clone(), ..self.config.clone() },
                );
            }
            Reply::RecordStatus => {
                let output_error = collector.file_error().map(ToString::to_string);
                let output_error = output_error.or(recording_failure);
                socket.respond(client, &RecordStatus { not_recorded: collector.not_recorded(), output_error });
            }
            Reply::Done => socket.respond(client, &()),
        }
    }

    /// Creates a new bus of the same name after files of the old one were removed. `next_tick` is
    /// the next tick to be output.
    fn renew_bus(&mut self, next_tick: u64) -> Result<(), UpError> {
        self.processes.kill_all();
        // The old topics are closed first, because the new ones have the same names.
        self.connection = None;
        self.file_monitor = FileMonitor::default();
        let Some(claim) = self.claim.take() else { return Ok(()) };
        let claim = self.claim.insert(claim.renew()?);
        self.optional_inputs.input = !self.checker.is_finished();
        self.connection =
            Some(BusConnection::open(claim.system_name(), &self.config, next_tick, self.optional_inputs)?);
        Ok(())
    }

    /// Waits for the next round.
    ///
    /// In lockstep the source waits for the attitude to be collected, so an attitude ends the wait.
    /// Otherwise the wait ends after a timeout or when a process exits.
    fn wait(&self) {
        let timeout = self.supervision.poll_interval();
        match &self.connection {
            Some(connection) if self.supervision.waits_for_output() => connection.wait(timeout),
            _ => self.processes.wait(timeout),
        }
    }

    /// Checks the input received since the previous call. Does nothing once the check is finished.
    fn check_input(&mut self) {
        let Some(connection) = &mut self.connection else { return };
        let warnings = connection.input.as_mut().map_or(Vec::new(), |input| input.poll(&mut self.checker));
        connection.input.take_if(|_| self.checker.is_finished());
        self.view.announce(warnings);
    }

    /// Creates the report of the run, which ended normally or with `failure`.
    fn report(&mut self, mut collector: Collector, failure: Option<UpError>) -> Report {
        let cpu_s_per_s = self.cpu_usage.cpu_s_per_s.unwrap_or_else(|| self.cpu_s_per_s());
        let mut failure = failure;
        if let Some(connection) = &self.connection {
            if self.supervision.local_next_tick().is_none() {
                failure = failure.or(connection.collect(&mut collector).err());
            }
            // Attitudes that were waiting for missing ticks are delivered. The missing ticks count
            // as lost.
            connection.finish(&mut collector);
            if let Some((topics, recorder)) = connection.recorded.as_ref().zip(self.recorder.as_mut()) {
                topics.poll(recorder);
            }
        }
        let ingest = self.connection.as_ref().filter(|_| self.supervision.launch().tick_source() == TickSource::Ingest);
        let published = ingest.map_or(0, |connection| connection.published(Service::Ingest));
        let services = self.supervision.entries().map(|(service, entry)| ServiceReport {
            name: service.name(),
            pid: entry.pid(),
            restarts: entry.restarts(),
        });
        let warnings = self.checker.finish();
        self.view.announce(warnings);
        let totals = RunTotals {
            warnings: std::mem::take(&mut self.checker).into_warnings(),
            ticks_in: self.supervision.ticks_in().max(published),
            ticks_out: self.supervision.local_next_tick(),
            rejected: self.supervision.rejected(),
            lost_readings: self.supervision.lost_readings(),
            cpu_s_per_s,
            services: services.collect(),
        };
        let is_empty = totals.ticks_in == 0 && self.supervision.launch().ingest.source == launch::Source::Stdin;
        let failure = failure.or_else(|| is_empty.then_some(UpError::NoReadings { source_name: "standard input" }));
        Report::new(collector, totals, failure)
    }

    fn cpu_s_per_s(&self) -> f64 {
        let CpuUsage { since, cpu_since_s, .. } = self.cpu_usage;
        (own_cpu_s() + self.processes.cpu_s() - cpu_since_s).max(0.0) / since.elapsed().as_secs_f64()
    }

    /// Terminates the remaining processes and returns the recorder.
    fn finish(mut self) -> Option<Recorder> {
        self.processes.terminate_all();
        let lines = self.warm.finish(self.supervision.newest_checkpoint(Service::Fuser));
        self.view.announce(lines);
        self.view.finish();
        self.recorder
    }
}

/// Creates the configuration of [`Supervision`].
fn supervision_config(plan: &Plan) -> Config {
    let config = &plan.config;
    Config {
        launch: config.launch.clone(),
        rate_hz: config.rate_hz,
        lockstep: config.is_lockstep(),
        window_ticks: config.window_ticks(),
        buffer_ticks: config.buffer_ticks() as u64,
        stop_after: plan.stop_after_s.map(Duration::from_secs_f64),
        validate: crate::plan::validate,
    }
}

fn output_progress(collector: &mut Collector) -> OutputProgress {
    OutputProgress {
        next_tick: collector.next_tick(),
        lost: collector.lost(),
        not_recorded: collector.not_recorded(),
        duplicated: collector.duplicated(),
        max_gap_ns: collector.take_gap_ns(),
        last_swap: collector.last_swap(),
    }
}
