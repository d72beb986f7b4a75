//! What the supervisor does for the coordinator: starts, ends, restarts, keeps checkpoints, and takes its time.

use swap::{Action, Event, Outcome, OutputGate};

use crate::{
    chance::{Chance, DELAY_MS},
    process::{Manner, Process},
    world::{INPUT_HISTORY_TICKS, World},
};

/// Something that the supervisor is about to do.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Task {
    Spawn { stage: u32, epoch: u32 },
    SpawnOwner { stage: u32, epoch: u32, from_tick: u64 },
    Kill { incarnation: u32 },
    Restart { epoch: u32, from_tick: u64 },
    TellDeath { incarnation: u32 },
}

impl Manner {
    pub(crate) fn good(ready_ms: u64, period_ms: u64, chance: &mut Chance) -> Self {
        Self {
            ready_ms,
            ticks_per_10_ms: 10 / period_ms * chance.between(2, 6) + 10,
            flawed_from: None,
            health_interval_ms: chance.between(1, 10),
            checkpoint_interval_ticks: chance.between(5, 40),
        }
    }
}

impl World {
    /// Tells the coordinator and does what it asks.
    pub(crate) fn apply(&mut self, event: Event) {
        let state = self.coordinator.state();
        let told = match &event {
            Event::Health { .. } | Event::Time => None,
            Event::NewestInput { .. } | Event::ReadersKeep { .. } | Event::Published { .. } => None,
            event => Some(format!("{event:?}")),
        };
        let actions = self.coordinator.handle(self.now_ms, event);
        if told.is_some() || state != self.coordinator.state() || !actions.is_empty() {
            self.narrate(|world| {
                format!("{} -> {:?} {actions:?}", told.unwrap_or_default(), world.coordinator.state())
            });
        }
        actions.into_iter().for_each(|action| self.act(action));
    }

    fn act(&mut self, action: Action) {
        let soon = |world: &mut Self, longest_ms| world.now_ms + world.chance.between(0, longest_ms);
        match action {
            Action::SpawnCandidate { stage, epoch } => {
                let due_ms = soon(self, 20);
                self.tasks.push((due_ms, Task::Spawn { stage: stage.parse().unwrap(), epoch }));
            }
            Action::SpawnOwner { stage, epoch, from_tick } => {
                self.tasks.retain(|(_, task)| !matches!(task, Task::Spawn { .. } | Task::Restart { .. }));
                let alive = self.processes.iter().filter(|process| process.alive).map(|process| process.incarnation);
                alive.collect::<Vec<_>>().into_iter().for_each(|incarnation| self.bury(incarnation));
                let (due_ms, stage) = (soon(self, 20), stage.parse().unwrap());
                self.stages.insert(epoch, stage);
                self.replaced.insert(epoch);
                self.tasks.push((due_ms, Task::SpawnOwner { stage, epoch, from_tick }));
            }
            Action::PublishControl(control) => {
                self.stages.insert(control.epoch, self.processes[control.owner as usize - 1].stage);
                self.controls.push(control);
                let times = self.chance.between(1, 2);
                for process in &mut self.processes {
                    (0..times).for_each(|_| process.controls.send(self.now_ms, &mut self.chance, control));
                }
            }
            Action::EndCandidate { incarnation } | Action::RetireOld { incarnation } => {
                // Now and then it is forgotten, and has to be asked for again.
                if !self.chance.happens(50) {
                    let due_ms = soon(self, 20);
                    self.tasks.push((due_ms, Task::Kill { incarnation }));
                }
            }
            Action::RestartActive { epoch, from_tick } => {
                let owner = &self.processes[self.owner as usize - 1];
                let hung = owner.hung_until_ms + 2 * self.nature.limits.restore_ms > self.now_ms;
                // The stage before is gone, and a reader could need what it had published.
                let again = self
                    .handovers
                    .last()
                    .filter(|(old, commit_tick)| from_tick < *commit_tick && !self.processes[*old as usize - 1].alive);
                self.made_again.extend(again.map(|(_, commit_tick)| *commit_tick));
                let need = !owner.alive || hung || owner.gate.status().missed || again.is_some();
                assert!(need, "restarted without need");
                self.stages.insert(epoch, owner.stage);
                // It is started once, as it was asked for last.
                self.tasks.retain(|(_, task)| !matches!(task, Task::Restart { .. }));
                let due_ms = soon(self, 60);
                self.tasks.push((due_ms, Task::Restart { epoch, from_tick }));
            }
            Action::Answer(report) => {
                if report.outcome == Outcome::Committed {
                    let commit_tick = report.commit_tick.unwrap();
                    let alone = self.replaced.contains(&report.epoch);
                    if !alone {
                        self.handovers.push((self.owner, commit_tick));
                    }
                    let mut kept = self.checkpoints[&self.owner].clone();
                    self.owner = self.coordinator.active().unwrap();
                    let own = self.checkpoints.entry(self.owner).or_default();
                    kept.retain(|tick| own.first().is_none_or(|first| tick < first));
                    own.splice(..0, kept);
                    let began = self.processes[self.owner as usize - 1].gate.status().published_from;
                    let known = if alone { began <= Some(commit_tick) } else { began == Some(commit_tick) };
                    assert!(began.is_some() && known, "committed before the new owner has published");
                }
                self.answers.push(report);
            }
        }
    }

    /// Does what is due.
    pub(crate) fn work(&mut self) {
        let now_ms = self.now_ms;
        // One by one: what is done may call off what is due.
        while let Some(place) = self.tasks.iter().position(|(due_ms, _)| *due_ms <= now_ms) {
            match self.tasks.remove(place).1 {
                Task::Spawn { stage, epoch } => self.spawn(stage, epoch, None),
                Task::SpawnOwner { stage, epoch, from_tick } => self.spawn(stage, epoch, Some(from_tick)),
                Task::Kill { incarnation } => {
                    let process = &mut self.processes[incarnation as usize - 1];
                    process.retired = process.alive;
                    self.bury(incarnation);
                }
                Task::Restart { epoch, from_tick } => self.restart(epoch, from_tick),
                Task::TellDeath { incarnation } => self.apply(Event::Died { incarnation }),
            }
        }
    }

    /// A process is no more; the supervisor hears of it a little later, once.
    pub(crate) fn bury(&mut self, incarnation: u32) {
        let Some(process) = self.processes.iter_mut().find(|process| process.incarnation == incarnation) else {
            return;
        };
        if std::mem::replace(&mut process.buried, true) {
            return;
        }
        process.alive = false;
        let (next_tick, due_ms) = (process.next_tick, self.now_ms + self.chance.between(0, DELAY_MS));
        self.tasks.push((due_ms, Task::TellDeath { incarnation }));
        self.narrate(|_| format!("{incarnation} ends at {next_tick}"));
    }

    /// Keeps a checkpoint if the coordinator admits it.
    pub(crate) fn keep(&mut self, incarnation: u32, next_tick: u64) {
        if self.coordinator.admits(incarnation, next_tick) {
            self.checkpoints.entry(incarnation).or_default().push(next_tick);
        }
    }

    /// Starts a candidate, or whoever begins with `from_tick` in the place of an owner that has ended.
    fn spawn(&mut self, stage: u32, epoch: u32, from_tick: Option<u64>) {
        if self.chance.happens(self.nature.bad_candidates_per_mille / 8) {
            return self.apply(Event::SpawnFailed { cause: "no such file".into() });
        }
        let ready_ms = self.now_ms + self.chance.between(0, 30);
        let mut manner = Manner::good(ready_ms, self.nature.period_ms, &mut self.chance);
        if self.chance.happens(self.nature.bad_candidates_per_mille) {
            match self.chance.between(0, 3) {
                0 => manner.ready_ms = u64::MAX,
                1 => manner.flawed_from = Some(self.next_input + self.chance.between(0, 50)),
                2 => manner.ticks_per_10_ms = self.chance.between(1, 3),
                _ => manner.ready_ms += 50,
            }
        }
        let begins = match from_tick {
            Some(from_tick) => self.goes_on_at(from_tick),
            None => self.checkpoints[&self.owner].last().copied().unwrap_or(0),
        };
        let incarnation = self.start(stage, begins, manner, |incarnation, keep| match from_tick {
            Some(from_tick) => OutputGate::owner(incarnation, epoch, from_tick, keep),
            None => OutputGate::candidate(incarnation, epoch, keep),
        });
        self.checkpoints.insert(incarnation, vec![begins]);
        self.apply(Event::Spawned { incarnation });
    }

    /// The newest checkpoint of the slot's owner that is no newer than those of its readers, as far as what it publishes begins before it.
    fn goes_on_at(&self, from_tick: u64) -> u64 {
        let readers = self.readers.iter().map(|reader| reader.checkpoint.next_tick).min();
        let limit = readers.filter(|_| self.nature.readers_restart).unwrap_or(u64::MAX).max(from_tick);
        let kept = &self.checkpoints[&self.owner];
        kept.iter().copied().filter(|tick| *tick <= limit).max().unwrap_or(kept[0])
    }

    /// Restarts the slot's owner.
    fn restart(&mut self, epoch: u32, from_tick: u64) {
        self.restarts += 1;
        self.bury(self.owner);
        let (kept, begins) = (self.checkpoints[&self.owner].clone(), self.goes_on_at(from_tick));
        let stage = self.stages[&epoch];
        let manner = Manner::good(self.now_ms, self.nature.period_ms, &mut self.chance);
        self.owner = self
            .start(stage, begins, manner, |incarnation, keep| OutputGate::owner(incarnation, epoch, from_tick, keep));
        self.checkpoints.insert(self.owner, kept);
        self.apply(Event::Restarted { incarnation: self.owner });
    }

    fn start(
        &mut self,
        stage: u32,
        begins: u64,
        manner: Manner,
        gate: impl FnOnce(u32, usize) -> OutputGate<crate::process::Packet>,
    ) -> u32 {
        assert!(begins + INPUT_HISTORY_TICKS >= self.next_input, "the history of the input is too short");
        let incarnation = self.processes.len() as u32 + 1;
        let gate = gate(incarnation, self.nature.kept_ticks);
        let outlets = std::iter::repeat_n(self.nature.outlet_ms, self.readers.len());
        let mut process = Process::new(incarnation, stage, gate, manner, begins, outlets, &mut self.chance);
        // Who joins late hears the decisions that were taken before.
        for control in &self.controls {
            process.controls.send(self.now_ms, &mut self.chance, *control);
        }
        self.processes.push(process);
        self.narrate(|world| format!("{incarnation} starts at {begins}, of stage {stage}; input {}", world.next_input));
        incarnation
    }
}
