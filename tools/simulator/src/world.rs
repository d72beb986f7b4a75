//! One world: a bus, processes, the supervisor, people who ask, and what befalls them, until the end.

use std::collections::{BTreeMap, VecDeque};

use launch::Service;
use runtime::ServiceConfig;
use supervision::{Config, Failure, Supervision};

use crate::{
    bus::Bus,
    collector::Collector,
    flight::{self, Flight, RATE_HZ},
    process::{Body, Process},
    random::Random,
    record::{Caller, SwapRecord},
    reference::{self, Undisturbed},
    setup::{Fault, Setup},
    slots::Turn,
};

/// How long after its flight a system may go on at most, ms.
const PATIENCE_MS: u64 = 45_000;

/// One world.
pub(crate) struct World {
    pub(crate) random: Random,
    pub(crate) setup: Setup,
    pub(crate) flight: &'static Flight,
    /// The same flight without any disturbance.
    pub(crate) undisturbed: &'static Undisturbed,
    pub(crate) now_ms: u64,
    pub(crate) bus: Bus,
    /// Its files were removed: who starts finds nobody.
    pub(crate) removed: bool,
    pub(crate) processes: Vec<Process>,
    pub(crate) supervision: Supervision,
    /// When the supervisor looks next, and until when it does not.
    pub(crate) wake_ms: u64,
    pub(crate) frozen_until_ms: u64,
    pub(crate) looked_ms: u64,
    pub(crate) end_asked: bool,
    pub(crate) collector: Collector,
    /// Processes that have ended and were not reaped, with how.
    pub(crate) dead: Vec<(u32, &'static str)>,
    pub(crate) callers: BTreeMap<u64, Caller>,
    pub(crate) requests: VecDeque<(u64, supervision::ControlRequest)>,
    pub(crate) gone: VecDeque<u64>,
    pub(crate) swaps: SwapRecord,
    pub(crate) finished: Option<Option<Failure>>,
    pub(crate) restarts: u64,
    pub(crate) verbose: bool,
}

impl World {
    /// The world of a seed; `verbose` tells its story.
    pub(crate) fn new(seed: u64, verbose: bool) -> Result<Self, String> {
        let mut random = Random::new(seed);
        let setup = Setup::new(&mut random, &|number| Ok(reference::undisturbed(number)?.flight.launch.clone()))?;
        let undisturbed = reference::undisturbed(setup.flight)?;
        let flight = &undisturbed.flight;
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
            undisturbed,
            now_ms: 0,
            bus,
            removed: false,
            processes: Vec::new(),
            supervision: Supervision::new(supervised, std::time::Duration::ZERO),
            wake_ms: 0,
            frozen_until_ms: 0,
            looked_ms: 0,
            end_asked: false,
            collector,
            dead: Vec::new(),
            callers: BTreeMap::new(),
            requests: VecDeque::new(),
            gone: VecDeque::new(),
            swaps: SwapRecord::default(),
            finished: None,
            restarts: 0,
            verbose,
            setup,
        };
        world.narrate(|world| format!("{:#?}", world.setup));
        world.join_bus();
        Ok(world)
    }

    /// Lives to the end of the system, and says what was wrong with it.
    pub(crate) fn run(mut self) -> Result<Self, String> {
        let flight_ms = self.setup.ticks * 1000 / RATE_HZ as u64 * 2;
        let faults = std::mem::take(&mut self.setup.faults);
        let mut faults = faults.into_iter().peekable();
        while self.finished.is_none() {
            self.now_ms = self.next_event_ms(faults.peek().map(|(at_ms, _)| *at_ms));
            if self.now_ms > flight_ms + PATIENCE_MS {
                let (taken, of) = (self.collector.taken.len(), self.setup.ticks);
                return Err(format!("it does not end: {taken} of {of} attitudes by {} ms", self.now_ms));
            }
            while let Some((_, fault)) = faults.next_if(|(at_ms, _)| *at_ms <= self.now_ms) {
                self.befall(fault);
            }
            self.callers_leave();
            self.work();
            if self.now_ms >= self.wake_ms.max(self.frozen_until_ms) {
                self.supervise()?;
            }
        }
        self.check()?;
        Ok(self)
    }

    /// When something happens next.
    fn next_event_ms(&self, fault_ms: Option<u64>) -> u64 {
        let turns = self.processes.iter().map(Process::next_turn_ms);
        let supervisor = [self.wake_ms.max(self.frozen_until_ms)];
        turns.chain(supervisor).chain(fault_ms).min().unwrap_or(0).max(self.now_ms + 1)
    }

    /// Every process whose turn it is has it.
    pub(crate) fn work(&mut self) {
        for index in 0..self.processes.len() {
            if self.processes[index].next_turn_ms() <= self.now_ms {
                self.turn(index);
            }
        }
        let dead = self.processes.extract_if(.., |process| process.how.is_some());
        for process in dead {
            self.bus.leave(process.incarnation);
            self.dead.push((process.incarnation, process.how.unwrap_or_default()));
        }
    }

    fn turn(&mut self, index: usize) {
        let process = &mut self.processes[index];
        let pause_ms = self.random.between(1, self.setup.turn_ms);
        process.wake_ms = self.now_ms + if self.random.happens(20) { 50 } else { pause_ms };
        if let Body::Starting { config, dies, .. } = &process.body {
            if *dies {
                process.how = Some("ended with code 1");
            } else if self.removed {
                process.body = Body::Deaf;
            } else {
                match Body::begin(process.service, &config.clone(), &mut self.bus) {
                    Ok(body) => process.body = body,
                    Err(_) => process.how = Some("ended with code 1"),
                }
            }
        }
        let mut turn = Turn {
            now_ms: self.now_ms,
            bus: &mut self.bus,
            random: &mut self.random,
            deliveries: process.deliveries,
            drop_per_mille: self.setup.drop_per_mille,
            flawed_from: process.flawed_from,
        };
        let output_tick = turn.bus.attitude.next_tick;
        let lives = process.body.poll(self.flight, &mut turn);
        if !lives {
            process.how = Some("was ended by signal 9");
        } else if process.asked {
            process.how.get_or_insert("ended with code 0");
        }
        // In lockstep the supervisor is woken by the attitude.
        if self.bus.attitude.next_tick != output_tick && self.supervision.waits_for_output() {
            self.wake_ms = self.wake_ms.min(self.now_ms + self.random.between(0, 3));
        }
    }

    fn befall(&mut self, fault: Fault) {
        self.narrate(|_| format!("{fault:?}"));
        match fault {
            Fault::Kill { service, candidate, deliveries } => {
                if let Some(process) = self.victim(service, candidate) {
                    process.kill(deliveries);
                }
            }
            Fault::Freeze { service, candidate, ms } => {
                let until_ms = self.now_ms + ms;
                if let Some(process) = self.victim(service, candidate) {
                    process.frozen_until_ms = process.frozen_until_ms.max(until_ms);
                }
            }
            Fault::FreezeSupervisor { ms } => self.frozen_until_ms = self.frozen_until_ms.max(self.now_ms + ms),
            Fault::RemoveFiles => self.removed = true,
            Fault::End => self.end_asked = true,
            request => self.ask(request),
        }
    }

    /// The newest process of a service, or of those that do not own its slot.
    fn victim(&mut self, service: Service, candidate: bool) -> Option<&mut Process> {
        let its = |process: &&mut Process| process.service == service && process.candidate == candidate;
        self.processes.iter_mut().rfind(its)
    }

    /// A line of the story, when it is told.
    pub(crate) fn narrate(&self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            eprintln!("{:6} {}", self.now_ms, line(self));
        }
    }
}
