//! One world: a source, the processes of a slot, two readers, a supervisor, and what befalls them until a certain time.

use std::collections::BTreeMap;

use swap::{Control, Coordinator, Event, Limits, Report, Request, State, Tenure};

pub use crate::check::Tally;
use crate::{
    chance::{Chance, Link},
    process::{Manner, Process, Word},
    reader::Reader,
    supervisor::Task,
};

/// Restarts and late starts find this much of their input.
pub const INPUT_HISTORY_TICKS: u64 = 1500;
const READERS: usize = 2;
/// After the last fault everything has to be in order within this time, ms.
const SETTLED_MS: u64 = 4000;
/// Longest time for which the supervisor does nothing, ms.
const STALL_MS: u64 = 30;

/// What this world is like.
#[derive(Debug)]
pub struct Nature {
    pub period_ms: u64,
    pub faults_until_ms: u64,
    pub deaths_per_mille: u64,
    pub hangs_per_mille: u64,
    pub bad_candidates_per_mille: u64,
    pub readers_restart: bool,
    pub supervisor_dies_ms: Option<u64>,
    pub keep_ticks: u64,
    pub limits: Limits,
}

impl Nature {
    fn new(chance: &mut Chance) -> Self {
        let readers_restart = chance.happens(300);
        let period_ms = chance.between(1, 3);
        let limits = Limits {
            ready_ms: 60,
            caught_up_ms: 80,
            shadow_ms: chance.between(0, 30),
            commit_ms: chance.between(60, 150),
            restore_ms: 120,
            linger_ms: if readers_restart { 1000 } else { chance.between(0, 60) },
            end_ms: 30,
            lag_max_ticks: chance.between(8, 20),
            margin_ticks: chance.between(0, 60),
        };
        let calm = chance.happens(300);
        Self {
            period_ms,
            faults_until_ms: chance.between(200, 700),
            deaths_per_mille: if calm { 0 } else { chance.between(0, 6) },
            hangs_per_mille: if calm { 0 } else { chance.between(0, 6) },
            bad_candidates_per_mille: if calm { 0 } else { chance.between(0, 400) },
            readers_restart,
            supervisor_dies_ms: chance.happens(20).then(|| chance.between(0, 700)),
            keep_ticks: limits.lag_max_ticks + limits.margin_ticks + (limits.commit_ms + 200) / period_ms,
            limits,
        }
    }
}

#[derive(Debug)]
pub struct World {
    pub chance: Chance,
    pub nature: Nature,
    pub now_ms: u64,
    pub next_input: u64,
    pub processes: Vec<Process>,
    pub readers: Vec<Reader>,
    pub coordinator: Coordinator,
    /// The slot's owner as the supervisor knows it.
    pub owner: u32,
    pub tasks: Vec<(u64, Task)>,
    /// Checkpoints kept, by incarnation.
    pub checkpoints: BTreeMap<u32, Vec<u64>>,
    pub controls: Vec<Control>,
    /// The stage named by each decision.
    pub stages: BTreeMap<u32, u32>,
    pub asked: BTreeMap<u64, (u64, bool)>,
    pub answers: Vec<Report>,
    pub restarts: u64,
    verbose: bool,
    newest_input: Link<u64>,
    readers_keep: Link<u64>,
    stalled_until_ms: u64,
}

impl World {
    pub fn new(seed: u64, verbose: bool) -> Self {
        let mut chance = Chance(seed);
        let nature = Nature::new(&mut chance);
        let tenure = Tenure::owner(1, 1, 0, nature.keep_ticks as usize);
        let manner = Manner::good(0, nature.period_ms, &mut chance);
        let checkpoint_interval_ticks = chance.between(5, 30);
        Self {
            processes: vec![Process::new(1, 0, tenure, manner, 0, READERS, &mut chance)],
            readers: (0..READERS).map(|_| Reader::new(nature.keep_ticks, checkpoint_interval_ticks)).collect(),
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
            restarts: 0,
            verbose,
            newest_input: Link::new(&mut chance),
            readers_keep: Link::new(&mut chance),
            stalled_until_ms: 0,
            chance,
        }
    }

    /// Lives until everything has settled; gives the world back for its figures.
    pub fn run(mut self) -> Result<Self, String> {
        self.tell(|world| format!("{:?}", world.nature));
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
                self.hear(Event::Cancel);
            }
            if self.now_ms > settled_by_ms {
                return Err(format!("nothing settles: {:?}", self.coordinator));
            }
        }
        let drained_by_ms = self.now_ms + 300;
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

    /// What people ask for.
    fn ask(&mut self) {
        if self.chance.happens(8) {
            let id = self.asked.len() as u64 + 1;
            let shadow_only = self.chance.happens(200);
            self.asked.insert(id, (self.now_ms, shadow_only));
            self.hear(Event::Request(Request { id, stage: id.to_string(), shadow_only }));
        }
        if self.chance.happens(5) {
            self.hear(Event::Promote);
        }
        if self.chance.happens(1) {
            self.hear(Event::Cancel);
        }
    }

    /// What goes wrong beside deaths: hangs, a supervisor that is busy, decisions that come again, readers that die.
    fn befall(&mut self) {
        let (chance, now_ms) = (&mut self.chance, self.now_ms);
        for process in &mut self.processes {
            if process.alive && chance.happens(self.nature.hangs_per_mille) {
                process.hung_until_ms = now_ms + chance.between(1, 150);
                if self.verbose {
                    println!("{now_ms:5} {} hangs until {}", process.incarnation, process.hung_until_ms);
                }
            }
        }
        if chance.happens(2) {
            self.stalled_until_ms = now_ms + chance.between(1, STALL_MS);
        }
        if chance.happens(10) && !self.controls.is_empty() {
            let again = self.controls[chance.between(0, self.controls.len() as u64 - 1) as usize];
            for process in &mut self.processes {
                process.controls.send(now_ms, chance, again);
            }
        }
        if self.nature.readers_restart && chance.happens(4) {
            let index = chance.between(0, READERS as u64 - 1) as usize;
            self.readers[index].restart(self.nature.keep_ticks);
            for process in &mut self.processes {
                process.outlets[index] = Link::new(chance);
                if process.alive {
                    for packet in &process.history {
                        process.outlets[index].send(now_ms, chance, *packet);
                    }
                }
            }
            self.tell(|world| format!("reader {index} restarts at {}", world.readers[index].got.len()));
        }
    }

    /// The processes work, and some die; more of them while hands change.
    fn live(&mut self, troubled: bool) {
        let newest = self.next_input.checked_sub(1 + self.chance.between(0, 3));
        let busy = !matches!(self.coordinator.state(), State::Idle | State::Starting | State::CatchingUp);
        let per_mille = if troubled { self.nature.deaths_per_mille * if busy { 4 } else { 1 } } else { 0 };
        let spared = match self.coordinator.state() {
            State::Committed { old } | State::Retiring { old } if self.nature.readers_restart => Some(old),
            _ => None,
        };
        let mut dead = Vec::new();
        for process in &mut self.processes {
            let dies = process.alive && Some(process.incarnation) != spared && self.chance.happens(per_mille);
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
                Word::Ready => self.hear(Event::Ready { incarnation }),
                Word::Health { standing, flawed } => self.hear(Event::Health { incarnation, standing, flawed }),
                Word::Checkpoint { next_tick } => self.keep(incarnation, next_tick),
            }
        }
        while let Some(tick) = self.newest_input.arrived(now_ms) {
            self.hear(Event::NewestInput { tick });
        }
        if let Some(next_tick) = self.readers.iter().map(|reader| reader.checkpoint.next_tick).min() {
            self.readers_keep.send(now_ms, &mut self.chance, next_tick);
        }
        while let Some(next_tick) = self.readers_keep.arrived(now_ms) {
            self.hear(Event::ReadersKeep { next_tick });
        }
        if self.chance.happens(400) {
            self.hear(Event::Passage);
        }
    }

    /// A line of the history, when one seed runs alone.
    pub fn tell(&self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            println!("{:5} {}", self.now_ms, line(self));
        }
    }
}
