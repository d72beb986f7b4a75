//! World of one seed: a source, the processes of a slot, two subscribers and a supervisor. Faults
//! stop at a certain time. Everything must settle after that.

use std::collections::{BTreeMap, BTreeSet};

use swap::{Coordinator, Event, OutputGate, OwnershipDecision, Report, SwapState};

use crate::{
    process::{Behaviour, Process, ServiceMessage},
    rng::{Link, MAX_DELAY_MS, SimRng},
    scenario::Scenario,
    subscriber::Subscriber,
    supervisor::Task,
};

/// Number of input ticks that a restarted or late process can still read.
pub(crate) const INPUT_HISTORY_TICKS: u64 = 1500;
pub(crate) const SUBSCRIBERS: usize = 2;
/// Time in ms after the last fault within which everything must settle.
const SETTLE_TIMEOUT_MS: u64 = 4000;
/// Time in ms within which the slowest stage must process its remaining input.
const DRAIN_TIMEOUT_MS: u64 = 15_000;

#[derive(Debug)]
pub(crate) struct World {
    pub(crate) rng: SimRng,
    pub(crate) scenario: Scenario,
    pub(crate) now_ms: u64,
    pub(crate) next_input: u64,
    pub(crate) processes: Vec<Process>,
    pub(crate) subscribers: Vec<Subscriber>,
    pub(crate) coordinator: Coordinator,
    /// Owner of the slot, as known to the supervisor.
    pub(crate) owner: u32,
    pub(crate) tasks: Vec<(u64, Task)>,
    /// Next ticks of the stored checkpoints, by incarnation.
    pub(crate) checkpoints: BTreeMap<u32, Vec<u64>>,
    pub(crate) decisions: Vec<OwnershipDecision>,
    /// Stage of the owner in each decision, by epoch.
    pub(crate) stages: BTreeMap<u32, u32>,
    pub(crate) requests: BTreeMap<u64, (u64, bool)>,
    pub(crate) reports: Vec<Report>,
    /// Previous owner and tick of each hand-over.
    pub(crate) handovers: Vec<(u32, u64)>,
    /// Ticks of the hand-overs at which the new stage had to republish earlier ticks.
    pub(crate) republished: BTreeSet<u64>,
    /// Epochs in which a stage replaced an exited owner.
    pub(crate) replaced: BTreeSet<u32>,
    pub(crate) restarts: u64,
    pub(crate) verbose: bool,
    newest_input: Link<u64>,
    subscribers_checkpoint: Link<u64>,
    pub(crate) stalled_until_ms: u64,
}

impl World {
    pub(crate) fn new(seed: u64, verbose: bool) -> Self {
        let mut rng = SimRng(seed);
        let scenario = Scenario::new(&mut rng);
        let gate = OutputGate::owner(1, 1, 0, scenario.history_ticks);
        let behaviour = Behaviour::healthy(0, scenario.period_ms, &mut rng);
        let links = std::iter::repeat_n(scenario.max_link_delay_ms, SUBSCRIBERS);
        let checkpoint_interval_ticks = rng.in_range(5, 30);
        Self {
            processes: vec![Process::new(1, 0, gate, behaviour, 0, links, &mut rng)],
            subscribers: (0..SUBSCRIBERS)
                .map(|_| Subscriber::new(scenario.lateness_ticks, checkpoint_interval_ticks))
                .collect(),
            coordinator: Coordinator::new(1, 1, scenario.limits),
            scenario,
            now_ms: 0,
            next_input: 0,
            owner: 1,
            tasks: Vec::new(),
            checkpoints: BTreeMap::from([(1, vec![0])]),
            decisions: Vec::new(),
            stages: BTreeMap::from([(1, 0)]),
            requests: BTreeMap::new(),
            reports: Vec::new(),
            handovers: Vec::new(),
            republished: BTreeSet::new(),
            replaced: BTreeSet::new(),
            restarts: 0,
            verbose,
            newest_input: Link::new(MAX_DELAY_MS, &mut rng),
            subscribers_checkpoint: Link::new(MAX_DELAY_MS, &mut rng),
            stalled_until_ms: 0,
            rng,
        }
    }

    /// Runs until everything has settled. Returns the world for its statistics.
    pub(crate) fn run(mut self) -> Result<Self, String> {
        self.trace(|world| format!("{:?}", world.scenario));
        let settled_by_ms = self.scenario.faults_until_ms + SETTLE_TIMEOUT_MS;
        loop {
            if self.scenario.supervisor_exits_ms.is_some_and(|exits_ms| exits_ms <= self.now_ms) {
                return Ok(self);
            }
            self.step(true)?;
            if self.now_ms > self.scenario.faults_until_ms && self.is_settled() {
                break;
            }
            if self.now_ms == self.scenario.faults_until_ms {
                self.apply(Event::Cancel);
            }
            if self.now_ms > settled_by_ms {
                return Err(format!("not settled in time: {:?}", self.coordinator));
            }
        }
        let drained_by_ms = self.now_ms + DRAIN_TIMEOUT_MS;
        while self.now_ms < drained_by_ms
            && self.subscribers.iter().any(|subscriber| subscriber.received.len() as u64 != self.next_input)
        {
            self.step(false)?;
        }
        self.check()?;
        Ok(self)
    }

    fn is_settled(&self) -> bool {
        self.coordinator.state() == SwapState::Idle
            && self.coordinator.active().is_some()
            && self.tasks.is_empty()
            && self.processes.iter().all(|process| !process.alive || process.hung_until_ms <= self.now_ms)
    }

    /// Simulates one millisecond.
    fn step(&mut self, source_runs: bool) -> Result<(), String> {
        self.now_ms += 1;
        if source_runs && self.now_ms.is_multiple_of(self.scenario.period_ms) {
            self.newest_input.send(self.now_ms, &mut self.rng, self.next_input);
            self.next_input += 1;
        }
        let has_faults = self.now_ms <= self.scenario.faults_until_ms;
        if has_faults {
            self.issue_requests();
            self.inject_faults();
        }
        self.step_processes(has_faults);
        self.deliver()?;
        if self.now_ms >= self.stalled_until_ms {
            self.supervise();
        }
        Ok(())
    }

    /// Steps the processes and lets some of them exit, more often during a hand-over.
    fn step_processes(&mut self, has_faults: bool) {
        let newest = self.next_input.checked_sub(1 + self.rng.in_range(0, 3));
        let in_handover =
            !matches!(self.coordinator.state(), SwapState::Idle | SwapState::Starting | SwapState::CatchingUp);
        let per_mille = if has_faults { self.scenario.exits_per_mille * if in_handover { 4 } else { 1 } } else { 0 };
        let mut exited = Vec::new();
        for process in &mut self.processes {
            let exits = process.alive && self.rng.chance(per_mille);
            process.step(self.now_ms, newest, exits, &mut self.rng);
            if exits {
                exited.push(process.incarnation);
            }
        }
        exited.into_iter().for_each(|incarnation| self.record_exit(incarnation));
    }

    /// Delivers messages to the subscribers, starting with the messages of a random process.
    fn deliver(&mut self) -> Result<(), String> {
        let first = self.rng.in_range(0, self.processes.len() as u64 - 1) as usize;
        let (behind, ahead) = self.processes.split_at_mut(first);
        for process in ahead.iter_mut().chain(behind) {
            for (number, (link, subscriber)) in process.links.iter_mut().zip(&mut self.subscribers).enumerate() {
                while let Some(packet) = link.arrived(self.now_ms) {
                    subscriber
                        .receive(packet)
                        .map_err(|failure| format!("{} ms, subscriber {number}: {failure}", self.now_ms))?;
                }
            }
        }
        Ok(())
    }

    /// Runs the due tasks of the supervisor and handles the messages that have arrived.
    fn supervise(&mut self) {
        let next_tick = self.processes.iter().map(|process| process.published_tick).max().unwrap_or(0);
        self.apply(Event::Published { next_tick });
        self.run_due_tasks();
        let now_ms = self.now_ms;
        let mut messages = Vec::new();
        for process in &mut self.processes {
            while let Some(message) = process.health.arrived(now_ms) {
                messages.push((process.incarnation, message));
            }
            while let Some(message) = process.checkpoints.arrived(now_ms) {
                messages.push((process.incarnation, message));
            }
        }
        for (incarnation, message) in messages {
            match message {
                ServiceMessage::Ready => self.apply(Event::Ready { incarnation }),
                ServiceMessage::Health { status, progress, invalid_output } => {
                    self.apply(Event::Health { incarnation, status, progress, invalid_output })
                }
                ServiceMessage::Checkpoint { next_tick } => self.store_checkpoint(incarnation, next_tick),
            }
        }
        while let Some(tick) = self.newest_input.arrived(now_ms) {
            self.apply(Event::NewestInput { tick });
        }
        if let Some(next_tick) = self.subscribers.iter().map(|subscriber| subscriber.checkpoint.next_tick).min() {
            self.subscribers_checkpoint.send(now_ms, &mut self.rng, next_tick);
        }
        while let Some(next_tick) = self.subscribers_checkpoint.arrived(now_ms) {
            self.apply(Event::SubscribersCheckpointed { next_tick });
        }
        if self.rng.chance(400) {
            self.apply(Event::TimePassed);
        }
    }

    /// Prints a line of the trace if only one seed is run.
    pub(crate) fn trace(&self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            println!("{:5} {}", self.now_ms, line(self));
        }
    }
}
