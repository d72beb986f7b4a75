//! Simulated system: bus, processes, supervisor, clients and faults, from start to stop.

use std::collections::{BTreeMap, VecDeque};

use launch::Service;
use runtime::ServiceConfig;
use supervision::{Config, Failure, FileFault, Supervision};

use crate::{
    bus::Bus,
    collector::Collector,
    flight::{self, Flight, RATE_HZ},
    process::{KILLED, Process, ProcessState},
    random::Random,
    record::{Client, SwapRecord},
    reference::{self, ReferenceRun},
    setup::{Fault, Setup},
    slots::PollContext,
};

/// Time in ms that a run may take in addition to twice the duration of its flight.
const MAX_OVERRUN_MS: u64 = 45_000;

/// Simulated system.
pub(crate) struct World {
    pub(crate) random: Random,
    pub(crate) setup: Setup,
    pub(crate) flight: &'static Flight,
    /// Run of the same flight without faults.
    pub(crate) reference_run: &'static ReferenceRun,
    pub(crate) now_ms: u64,
    pub(crate) bus: Bus,
    /// Current fault of the bus files, if any. A process that starts after a removal creates a new
    /// bus, which no other process uses. A process that starts after damage exits with an error.
    pub(crate) file_fault: Option<FileFault>,
    pub(crate) processes: Vec<Process>,
    pub(crate) supervision: Supervision,
    /// Time of the next round of the supervisor, ms.
    pub(crate) wake_ms: u64,
    /// Time in ms until which the supervisor is suspended.
    pub(crate) frozen_until_ms: u64,
    /// Time in ms of the last check that the files of the bus exist.
    pub(crate) files_checked_ms: u64,
    pub(crate) stop_requested: bool,
    pub(crate) collector: Collector,
    /// Exited processes with their exit status, until the supervisor handles them.
    pub(crate) exited: Vec<(u32, &'static str)>,
    pub(crate) clients: BTreeMap<u64, Client>,
    pub(crate) requests: VecDeque<(u64, control::ControlRequest)>,
    pub(crate) disconnected: VecDeque<u64>,
    pub(crate) swaps: SwapRecord,
    pub(crate) finished: Option<Option<Failure>>,
    pub(crate) restarts: u64,
    pub(crate) verbose: bool,
}

impl World {
    /// Creates the system for a seed. If `verbose` is set, each event is printed to standard error.
    pub(crate) fn new(seed: u64, verbose: bool) -> Result<Self, String> {
        let mut random = Random::new(seed);
        let setup = Setup::new(&mut random, &|number| Ok(reference::reference_run(number)?.flight.launch.clone()))?;
        let reference_run = reference::reference_run(setup.flight)?;
        let flight = &reference_run.flight;
        let config = ServiceConfig { launch: setup.launch.clone(), pace: setup.pace, ..flight::config(&setup.launch) };
        let supervised = Config {
            launch: setup.launch.clone(),
            rate_hz: RATE_HZ,
            lockstep: config.is_lockstep(),
            window_ticks: config.window_ticks(),
            buffer_ticks: config.buffer_ticks() as u64,
            stop_after: None,
            validate: |_, _| Ok(()),
        };
        let mut bus = Bus::new(config.buffer_ticks());
        let collector = Collector::new(&mut bus, 0, &config);
        let mut world = Self {
            random,
            flight,
            reference_run,
            now_ms: 0,
            bus,
            file_fault: None,
            processes: Vec::new(),
            supervision: Supervision::new(supervised, std::time::Duration::ZERO),
            wake_ms: 0,
            frozen_until_ms: 0,
            files_checked_ms: 0,
            stop_requested: false,
            collector,
            exited: Vec::new(),
            clients: BTreeMap::new(),
            requests: VecDeque::new(),
            disconnected: VecDeque::new(),
            swaps: SwapRecord::default(),
            finished: None,
            restarts: 0,
            verbose,
            setup,
        };
        world.trace(|world| format!("{:#?}", world.setup));
        world.join_bus();
        Ok(world)
    }

    /// Runs until the system stops, and checks the result. Returns the cause if the check fails.
    pub(crate) fn run(mut self) -> Result<Self, String> {
        let flight_ms = self.setup.ticks * 1000 / RATE_HZ as u64 * 2;
        let faults = std::mem::take(&mut self.setup.faults);
        let mut faults = faults.into_iter().peekable();
        while self.finished.is_none() {
            self.now_ms = self.next_event_ms(faults.peek().map(|(at_ms, _)| *at_ms));
            if self.now_ms > flight_ms + MAX_OVERRUN_MS {
                let (published, expected) = (self.collector.attitudes.len(), self.setup.ticks);
                return Err(format!("did not stop: {published} of {expected} attitudes after {} ms", self.now_ms));
            }
            while let Some((_, fault)) = faults.next_if(|(at_ms, _)| *at_ms <= self.now_ms) {
                self.inject_fault(fault);
            }
            self.disconnect_clients();
            self.poll_processes();
            if self.now_ms >= self.wake_ms.max(self.frozen_until_ms) {
                self.supervise()?;
            }
        }
        self.check()?;
        Ok(self)
    }

    /// Returns the time of the next event, ms.
    fn next_event_ms(&self, fault_ms: Option<u64>) -> u64 {
        let polls = self.processes.iter().map(Process::next_poll_ms);
        let supervisor = [self.wake_ms.max(self.frozen_until_ms)];
        polls.chain(supervisor).chain(fault_ms).min().unwrap_or(0).max(self.now_ms + 1)
    }

    /// Polls the processes that are due, and removes those that have exited.
    pub(crate) fn poll_processes(&mut self) {
        for index in 0..self.processes.len() {
            if self.processes[index].next_poll_ms() <= self.now_ms {
                self.poll_process(index);
            }
        }
        let exited = self.processes.extract_if(.., |process| process.exit_status.is_some());
        for process in exited {
            self.bus.remove_process(process.incarnation);
            self.exited.push((process.incarnation, process.exit_status.unwrap_or_default()));
        }
    }

    fn poll_process(&mut self, index: usize) {
        let process = &mut self.processes[index];
        let pause_ms = self.random.between(1, self.setup.max_poll_interval_ms);
        process.wake_ms = self.now_ms + if self.random.chance(20) { 50 } else { pause_ms };
        if let ProcessState::Starting { config, fails, .. } = &process.state {
            if *fails || self.file_fault == Some(FileFault::Damaged) {
                process.exit_status = Some("exited with code 1");
            } else if self.file_fault.is_some() {
                process.state = ProcessState::Unresponsive;
            } else {
                match ProcessState::start(process.service, &config.clone(), &mut self.bus) {
                    Ok(state) => process.state = state,
                    Err(_) => process.exit_status = Some("exited with code 1"),
                }
            }
        }
        let mut context = PollContext {
            now_ms: self.now_ms,
            bus: &mut self.bus,
            random: &mut self.random,
            deliveries_left: process.deliveries_left,
            lost_report_per_mille: self.setup.lost_report_per_mille,
            invalid_from_tick: process.invalid_from_tick,
        };
        let output_tick = context.bus.attitude.next_tick;
        let is_alive = process.state.poll(self.flight, &mut context);
        if !is_alive {
            process.exit_status = Some(KILLED);
        } else if process.terminate_requested {
            process.exit_status.get_or_insert("exited with code 0");
        }
        // In lockstep a new attitude wakes the supervisor.
        if self.bus.attitude.next_tick != output_tick && self.supervision.waits_for_output() {
            self.wake_ms = self.wake_ms.min(self.now_ms + self.random.between(0, 3));
        }
    }

    fn inject_fault(&mut self, fault: Fault) {
        self.trace(|_| format!("{fault:?}"));
        match fault {
            Fault::Kill { service, candidate, deliveries_left } => {
                if let Some(process) = self.target(service, candidate) {
                    process.kill(deliveries_left);
                }
            }
            Fault::Freeze { service, candidate, ms } => {
                let until_ms = self.now_ms + ms;
                if let Some(process) = self.target(service, candidate) {
                    process.frozen_until_ms = process.frozen_until_ms.max(until_ms);
                }
            }
            Fault::FreezeSupervisor { ms } => self.frozen_until_ms = self.frozen_until_ms.max(self.now_ms + ms),
            Fault::RemoveFiles => self.file_fault = Some(FileFault::Removed),
            Fault::DamageFiles { service, deliveries_left } => {
                self.file_fault = Some(FileFault::Damaged);
                if let Some(process) = self.target(service, false) {
                    process.kill(Some(deliveries_left));
                }
            }
            Fault::Stop => self.stop_requested = true,
            request => self.send_request(request),
        }
    }

    /// Returns the newest process of a service that was started as a candidate, or as an owner if
    /// `candidate` is not set.
    fn target(&mut self, service: Service, candidate: bool) -> Option<&mut Process> {
        let matches = |process: &&mut Process| process.service == service && process.candidate == candidate;
        self.processes.iter_mut().rfind(matches)
    }

    /// Prints an event if `verbose` is set.
    pub(crate) fn trace(&self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            eprintln!("{:6} {}", self.now_ms, line(self));
        }
    }
}
