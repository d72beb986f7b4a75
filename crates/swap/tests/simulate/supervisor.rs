//! Supervisor: carries out the coordinator's actions with random delays and stores checkpoints.

use swap::{Action, Event, OutputGate, SwapOutcome};

use crate::{
    process::{Behaviour, Process},
    rng::{MAX_DELAY_MS, SimRng},
    world::{INPUT_HISTORY_TICKS, World},
};

/// Scheduled task of the supervisor.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Task {
    Spawn { stage: u32, epoch: u32 },
    SpawnOwner { stage: u32, epoch: u32, from_tick: u64 },
    Kill { incarnation: u32 },
    Restart { epoch: u32, from_tick: u64 },
    ReportExit { incarnation: u32 },
}

impl Behaviour {
    pub(crate) fn healthy(ready_ms: u64, period_ms: u64, rng: &mut SimRng) -> Self {
        Self {
            ready_ms,
            ticks_per_10_ms: 10 / period_ms * rng.in_range(2, 6) + 10,
            invalid_from: None,
            health_interval_ms: rng.in_range(1, 10),
            checkpoint_interval_ticks: rng.in_range(5, 40),
        }
    }
}

impl World {
    /// Passes an event to the coordinator and carries out its actions.
    pub(crate) fn apply(&mut self, event: Event) {
        let state = self.coordinator.state();
        let description = match &event {
            Event::Health { .. } | Event::TimePassed => None,
            Event::NewestInput { .. } | Event::SubscribersCheckpointed { .. } | Event::Published { .. } => None,
            event => Some(format!("{event:?}")),
        };
        let actions = self.coordinator.handle(self.now_ms, event);
        if description.is_some() || state != self.coordinator.state() || !actions.is_empty() {
            self.trace(|world| {
                format!("{} -> {:?} {actions:?}", description.unwrap_or_default(), world.coordinator.state())
            });
        }
        actions.into_iter().for_each(|action| self.act(action));
    }

    fn act(&mut self, action: Action) {
        let due_within = |world: &mut Self, longest_ms| world.now_ms + world.rng.in_range(0, longest_ms);
        match action {
            Action::SpawnCandidate { stage, epoch } => {
                let due_ms = due_within(self, 20);
                self.tasks.push((due_ms, Task::Spawn { stage: stage.parse().unwrap(), epoch }));
            }
            Action::SpawnOwner { stage, epoch, from_tick } => {
                self.tasks.retain(|(_, task)| !matches!(task, Task::Spawn { .. } | Task::Restart { .. }));
                let alive = self.processes.iter().filter(|process| process.alive).map(|process| process.incarnation);
                alive.collect::<Vec<_>>().into_iter().for_each(|incarnation| self.record_exit(incarnation));
                let (due_ms, stage) = (due_within(self, 20), stage.parse().unwrap());
                self.stages.insert(epoch, stage);
                self.replaced.insert(epoch);
                self.tasks.push((due_ms, Task::SpawnOwner { stage, epoch, from_tick }));
            }
            Action::PublishDecision(decision) => {
                self.stages.insert(decision.epoch, self.processes[decision.owner as usize - 1].stage);
                self.decisions.push(decision);
                let times = self.rng.in_range(1, 2);
                for process in &mut self.processes {
                    (0..times).for_each(|_| process.decisions.send(self.now_ms, &mut self.rng, decision));
                }
            }
            Action::StopCandidate { incarnation } | Action::RetirePrevious { incarnation } => {
                // Some stop requests are dropped, so that the coordinator has to repeat them.
                if !self.rng.chance(50) {
                    let due_ms = due_within(self, 20);
                    self.tasks.push((due_ms, Task::Kill { incarnation }));
                }
            }
            Action::RestartActive { epoch, from_tick } => {
                let owner = &self.processes[self.owner as usize - 1];
                let hung = owner.hung_until_ms + 2 * self.scenario.limits.restore_timeout_ms > self.now_ms;
                // A subscriber may need ticks that the previous stage published before it exited.
                let lost_handover = self.handovers.last().filter(|(previous, commit_tick)| {
                    from_tick < *commit_tick && !self.processes[*previous as usize - 1].alive
                });
                self.republished.extend(lost_handover.map(|(_, commit_tick)| *commit_tick));
                let is_necessary = !owner.alive || hung || owner.gate.status().missed || lost_handover.is_some();
                assert!(is_necessary, "unnecessary restart");
                self.stages.insert(epoch, owner.stage);
                // Only the most recently requested restart is carried out.
                self.tasks.retain(|(_, task)| !matches!(task, Task::Restart { .. }));
                let due_ms = due_within(self, 60);
                self.tasks.push((due_ms, Task::Restart { epoch, from_tick }));
            }
            Action::Report(report) => {
                if report.outcome == SwapOutcome::Committed {
                    let commit_tick = report.commit_tick.unwrap();
                    let is_takeover = self.replaced.contains(&report.epoch);
                    if !is_takeover {
                        self.handovers.push((self.owner, commit_tick));
                    }
                    let mut kept = self.checkpoints[&self.owner].clone();
                    let lost_before = self.processes[self.owner as usize - 1].lost;
                    self.owner = self.coordinator.active().unwrap();
                    let has_missed = self.processes[self.owner as usize - 1].lost > lost_before;
                    let is_shadow = self.requests.get(&report.id).is_some_and(|(_, shadow_only)| *shadow_only);
                    assert!(!has_missed || is_shadow, "committed a stage that missed ticks");
                    let own = self.checkpoints.entry(self.owner).or_default();
                    kept.retain(|tick| own.first().is_none_or(|first| tick < first));
                    own.splice(..0, kept);
                    let published_from = self.processes[self.owner as usize - 1].gate.status().published_from;
                    let is_consistent = if is_takeover {
                        published_from <= Some(commit_tick)
                    } else {
                        published_from == Some(commit_tick)
                    };
                    assert!(published_from.is_some() && is_consistent, "committed before the new owner published");
                }
                self.reports.push(report);
            }
        }
    }

    /// Runs the tasks that are due.
    pub(crate) fn run_due_tasks(&mut self) {
        let now_ms = self.now_ms;
        // Tasks are run one at a time, because a task can cancel others.
        while let Some(index) = self.tasks.iter().position(|(due_ms, _)| *due_ms <= now_ms) {
            match self.tasks.remove(index).1 {
                Task::Spawn { stage, epoch } => self.spawn(stage, epoch, None),
                Task::SpawnOwner { stage, epoch, from_tick } => self.spawn(stage, epoch, Some(from_tick)),
                Task::Kill { incarnation } => {
                    let process = &mut self.processes[incarnation as usize - 1];
                    process.retired = process.alive;
                    self.record_exit(incarnation);
                }
                Task::Restart { epoch, from_tick } => self.restart(epoch, from_tick),
                Task::ReportExit { incarnation } => self.apply(Event::Exited { incarnation }),
            }
        }
    }

    /// Records the exit of a process. The supervisor is notified once, after a delay.
    pub(crate) fn record_exit(&mut self, incarnation: u32) {
        let Some(process) = self.processes.iter_mut().find(|process| process.incarnation == incarnation) else {
            return;
        };
        if std::mem::replace(&mut process.exit_recorded, true) {
            return;
        }
        process.alive = false;
        let (next_tick, due_ms) = (process.next_tick, self.now_ms + self.rng.in_range(0, MAX_DELAY_MS));
        self.tasks.push((due_ms, Task::ReportExit { incarnation }));
        self.trace(|_| format!("{incarnation} exits at {next_tick}"));
    }

    /// Stores a checkpoint if the coordinator admits it.
    pub(crate) fn store_checkpoint(&mut self, incarnation: u32, next_tick: u64) {
        if self.coordinator.admits_checkpoint(incarnation, next_tick) {
            self.checkpoints.entry(incarnation).or_default().push(next_tick);
        }
    }

    /// Starts a candidate or, if `from_tick` is given, a stage in place of an owner that has
    /// exited.
    fn spawn(&mut self, stage: u32, epoch: u32, from_tick: Option<u64>) {
        if self.rng.chance(self.scenario.bad_candidates_per_mille / 8) {
            return self.apply(Event::SpawnFailed { cause: "no such file".into() });
        }
        let ready_ms = self.now_ms + self.rng.in_range(0, 30);
        let mut behaviour = Behaviour::healthy(ready_ms, self.scenario.period_ms, &mut self.rng);
        let mut missed_ticks = 0;
        if self.rng.chance(self.scenario.bad_candidates_per_mille) {
            match self.rng.in_range(0, 4) {
                0 => behaviour.ready_ms = u64::MAX,
                1 => behaviour.invalid_from = Some(self.next_input + self.rng.in_range(0, 50)),
                2 => behaviour.ticks_per_10_ms = self.rng.in_range(1, 3),
                3 if from_tick.is_none() => missed_ticks = self.rng.in_range(1, 20),
                _ => behaviour.ready_ms += 50,
            }
        }
        let first_tick = match from_tick {
            Some(from_tick) => self.resume_tick(from_tick),
            None => self.checkpoints[&self.owner].last().copied().unwrap_or(0) + missed_ticks,
        };
        let incarnation = self.start(stage, first_tick, missed_ticks, behaviour, |incarnation, keep| match from_tick {
            Some(from_tick) => OutputGate::owner(incarnation, epoch, from_tick, keep),
            None => OutputGate::candidate(incarnation, epoch, keep),
        });
        self.checkpoints.insert(incarnation, vec![first_tick]);
        self.apply(Event::Spawned { incarnation });
    }

    /// Returns the tick of the newest checkpoint from which the slot's owner can resume.
    ///
    /// If subscribers can restart, only checkpoints up to a limit are considered. The limit is the
    /// oldest checkpoint of the subscribers, or `from_tick` if that is later.
    fn resume_tick(&self, from_tick: u64) -> u64 {
        let oldest = self.subscribers.iter().map(|subscriber| subscriber.checkpoint.next_tick).min();
        let limit = oldest.filter(|_| self.scenario.subscribers_restart).unwrap_or(u64::MAX).max(from_tick);
        let kept = &self.checkpoints[&self.owner];
        kept.iter().copied().filter(|tick| *tick <= limit).max().unwrap_or(kept[0])
    }

    /// Restarts the owner of the slot.
    fn restart(&mut self, epoch: u32, from_tick: u64) {
        self.restarts += 1;
        self.record_exit(self.owner);
        let (kept, first_tick) = (self.checkpoints[&self.owner].clone(), self.resume_tick(from_tick));
        let stage = self.stages[&epoch];
        let behaviour = Behaviour::healthy(self.now_ms, self.scenario.period_ms, &mut self.rng);
        self.owner = self.start(stage, first_tick, 0, behaviour, |incarnation, keep| {
            OutputGate::owner(incarnation, epoch, from_tick, keep)
        });
        self.checkpoints.insert(self.owner, kept);
        self.apply(Event::Restarted { incarnation: self.owner });
    }

    fn start(
        &mut self,
        stage: u32,
        first_tick: u64,
        missed_ticks: u64,
        behaviour: Behaviour,
        gate: impl FnOnce(u32, usize) -> OutputGate<crate::process::Packet>,
    ) -> u32 {
        assert!(first_tick + INPUT_HISTORY_TICKS >= self.next_input, "the input history is too short");
        let incarnation = self.processes.len() as u32 + 1;
        let gate = gate(incarnation, self.scenario.history_ticks);
        let links = std::iter::repeat_n(self.scenario.max_link_delay_ms, self.subscribers.len());
        let mut process = Process::new(incarnation, stage, gate, behaviour, first_tick, links, &mut self.rng);
        process.lost = missed_ticks + self.processes.get(self.owner as usize - 1).map_or(0, |owner| owner.lost);
        // A process that starts late also receives the earlier decisions.
        for decision in &self.decisions {
            process.decisions.send(self.now_ms, &mut self.rng, *decision);
        }
        self.processes.push(process);
        self.trace(|world| {
            format!("{incarnation} starts at {first_tick}, of stage {stage}; input {}", world.next_input)
        });
        incarnation
    }
}
