//! One world: a source, the processes of a slot, two readers, a supervisor, and what befalls them until a certain time.

use std::collections::{BTreeMap, BTreeSet};

use swap::{Control, Coordinator, Event, OutputGate, Report, State};

use crate::{
    chance::{Chance, DELAY_MS, Link},
    nature::Nature,
    process::{Manner, Process, Word},
    reader::Reader,
    supervisor::Task,
};

/// Restarts and late starts find this much of their input.
pub(crate) const INPUT_HISTORY_TICKS: u64 = 1500;
pub(crate) const READERS: usize = 2;
/// After the last fault everything has to be in order within this time, ms.
const SETTLED_MS: u64 = 4000;
/// What the slowest stage needs for the input that it is behind, ms.
const DRAINED_MS: u64 = 15_000;

#[derive(Debug)]
pub(crate) struct World {
    pub(crate) chance: Chance,
    pub(crate) nature: Nature,
    pub(crate) now_ms: u64,
    pub(crate) next_input: u64,
    pub(crate) processes: Vec<Process>,
    pub(crate) readers: Vec<Reader>,
    pub(crate) coordinator: Coordinator,
    /// The slot's owner as the supervisor knows it.
    pub(crate) owner: u32,
    pub(crate) tasks: Vec<(u64, Task)>,
    /// Checkpoints kept, by incarnation.
    pub(crate) checkpoints: BTreeMap<u32, Vec<u64>>,
    pub(crate) controls: Vec<Control>,
    /// The stage named by each decision.
    pub(crate) stages: BTreeMap<u32, u32>,
    pub(crate) asked: BTreeMap<u64, (u64, bool)>,
    pub(crate) answers: Vec<Report>,
    /// Who had the slot before a commitment, and its tick.
    pub(crate) handovers: Vec<(u32, u64)>,
    /// Commitments before whose tick the new stage had to publish, too.
    pub(crate) made_again: BTreeSet<u64>,
    /// Decisions under which somebody began in the place of an owner that had ended.
    pub(crate) replaced: BTreeSet<u32>,
    pub(crate) restarts: u64,
    pub(crate) verbose: bool,
    newest_input: Link<u64>,
    readers_keep: Link<u64>,
    pub(crate) stalled_until_ms: u64,
}

impl World {
    pub(crate) fn new(seed: u64, verbose: bool) -> Self {
        let mut chance = Chance(seed);
        let nature = Nature::new(&mut chance);
        let gate = OutputGate::owner(1, 1, 0, nature.kept_ticks);
        let manner = Manner::good(0, nature.period_ms, &mut chance);
        let outlets = std::iter::repeat_n(nature.outlet_ms, READERS);
        let checkpoint_interval_ticks = chance.between(5, 30);
        Self {
            processes: vec![Process::new(1, 0, gate, manner, 0, outlets, &mut chance)],
            readers: (0..READERS).map(|_| Reader::new(nature.lateness_ticks, checkpoint_interval_ticks)).collect(),
            coordinator: Coordinator::new(1, 1, nature.limits),
            nature,
            now_ms: 0,
            next_input: 0,
            owner: 1,
            tasks: Vec::new(),
            checkpoints: BTreeMap::from([(1, vec![0])]),
            controls: Vec::new(),
            stages: BTreeMap::from([(1, 0)]),
            asked: BTreeMap::new(),
            answers: Vec::new(),
            handovers: Vec::new(),
            made_again: BTreeSet::new(),
            replaced: BTreeSet::new(),
            restarts: 0,
            verbose,
            newest_input: Link::new(DELAY_MS, &mut chance),
            readers_keep: Link::new(DELAY_MS, &mut chance),
            stalled_until_ms: 0,
            chance,
        }
    }

    /// Lives until everything has settled; gives the world back for its figures.
    pub(crate) fn run(mut self) -> Result<Self, String> {
        self.narrate(|world| format!("{:?}", world.nature));
        let settled_by_ms = self.nature.faults_until_ms + SETTLED_MS;
        loop {
            if self.nature.supervisor_dies_ms.is_some_and(|dies_ms| dies_ms <= self.now_ms) {
                return Ok(self);
            }
            self.step(true)?;
            if self.now_ms > self.nature.faults_until_ms && self.is_settled() {
                break;
            }
            if self.now_ms == self.nature.faults_until_ms {
                self.apply(Event::Cancel);
            }
            if self.now_ms > settled_by_ms {
                return Err(format!("nothing settles: {:?}", self.coordinator));
            }
        }
        let drained_by_ms = self.now_ms + DRAINED_MS;
        while self.now_ms < drained_by_ms
            && self.readers.iter().any(|reader| reader.got.len() as u64 != self.next_input)
        {
            self.step(false)?;
        }
        self.check()?;
        Ok(self)
    }

    fn is_settled(&self) -> bool {
        self.coordinator.state() == State::Idle
            && self.coordinator.active().is_some()
            && self.tasks.is_empty()
            && self.processes.iter().all(|process| !process.alive || process.hung_until_ms <= self.now_ms)
    }

    /// One millisecond.
    fn step(&mut self, source_runs: bool) -> Result<(), String> {
        self.now_ms += 1;
        if source_runs && self.now_ms.is_multiple_of(self.nature.period_ms) {
            self.newest_input.send(self.now_ms, &mut self.chance, self.next_input);
            self.next_input += 1;
        }
        let troubled = self.now_ms <= self.nature.faults_until_ms;
        if troubled {
            self.ask();
            self.befall();
        }
        self.live(troubled);
        self.read()?;
        if self.now_ms >= self.stalled_until_ms {
            self.supervise();
        }
        Ok(())
    }

    /// The processes work, and some die; more of them while hands change.
    fn live(&mut self, troubled: bool) {
        let newest = self.next_input.checked_sub(1 + self.chance.between(0, 3));
        let busy = !matches!(self.coordinator.state(), State::Idle | State::Starting | State::CatchingUp);
        let per_mille = if troubled { self.nature.deaths_per_mille * if busy { 4 } else { 1 } } else { 0 };
        let mut dead = Vec::new();
        for process in &mut self.processes {
            let dies = process.alive && self.chance.happens(per_mille);
            process.step(self.now_ms, newest, dies, &mut self.chance);
            if dies {
                dead.push(process.incarnation);
            }
        }
        dead.into_iter().for_each(|incarnation| self.bury(incarnation));
    }

    /// Messages arrive at the readers, from the processes in any order.
    fn read(&mut self) -> Result<(), String> {
        let first = self.chance.between(0, self.processes.len() as u64 - 1) as usize;
        let (behind, ahead) = self.processes.split_at_mut(first);
        for process in ahead.iter_mut().chain(behind) {
            for (number, (outlet, reader)) in process.outlets.iter_mut().zip(&mut self.readers).enumerate() {
                while let Some(packet) = outlet.arrived(self.now_ms) {
                    reader.take(packet).map_err(|wrong| format!("{} ms, reader {number}: {wrong}", self.now_ms))?;
                }
            }
        }
        Ok(())
    }

    /// The supervisor does what is due and hears what has arrived.
    fn supervise(&mut self) {
        let next_tick = self.processes.iter().map(|process| process.published_tick).max().unwrap_or(0);
        self.apply(Event::Published { next_tick });
        self.work();
        let now_ms = self.now_ms;
        let mut heard = Vec::new();
        for process in &mut self.processes {
            while let Some(word) = process.words.arrived(now_ms) {
                heard.push((process.incarnation, word));
            }
            while let Some(word) = process.checkpoints.arrived(now_ms) {
                heard.push((process.incarnation, word));
            }
        }
        for (incarnation, word) in heard {
            match word {
                Word::Ready => self.apply(Event::Ready { incarnation }),
                Word::Health { status, flawed } => self.apply(Event::Health { incarnation, status, flawed }),
                Word::Checkpoint { next_tick } => self.keep(incarnation, next_tick),
            }
        }
        while let Some(tick) = self.newest_input.arrived(now_ms) {
            self.apply(Event::NewestInput { tick });
        }
        if let Some(next_tick) = self.readers.iter().map(|reader| reader.checkpoint.next_tick).min() {
            self.readers_keep.send(now_ms, &mut self.chance, next_tick);
        }
        while let Some(next_tick) = self.readers_keep.arrived(now_ms) {
            self.apply(Event::ReadersKeep { next_tick });
        }
        if self.chance.happens(400) {
            self.apply(Event::Time);
        }
    }

    /// A line of the history, when one seed runs alone.
    pub(crate) fn narrate(&self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            println!("{:5} {}", self.now_ms, line(self));
        }
    }
}
