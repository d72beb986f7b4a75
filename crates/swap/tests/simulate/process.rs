//! Service of the slot. It computes as far as its input allows and applies decisions. It can hang,
//! fail and exit between any two messages.

use std::collections::VecDeque;

use swap::{OutputGate, OwnershipDecision, OwnershipStatus, Progress, Stamped};

use crate::rng::{Link, MAX_DELAY_MS, SimRng};

/// Output of a service. Before it is stamped, it depends only on the stage and the tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) tick: u64,
    pub(crate) epoch: u32,
    pub(crate) incarnation: u32,
    pub(crate) stage: u32,
}

impl Stamped for Packet {
    fn tick(&self) -> u64 {
        self.tick
    }

    fn epoch(&self) -> u32 {
        self.epoch
    }

    fn incarnation(&self) -> u32 {
        self.incarnation
    }

    fn stamp(&mut self, epoch: u32, incarnation: u32) {
        (self.epoch, self.incarnation) = (epoch, incarnation);
    }
}

/// Message from a service to the supervisor.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ServiceMessage {
    Ready,
    Health { status: OwnershipStatus, progress: Progress, invalid_output: bool },
    Checkpoint { next_tick: u64 },
}

/// Behaviour of a process.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Behaviour {
    /// Time in ms at which the process opens its topics.
    pub(crate) ready_ms: u64,
    /// Number of ticks that the process can compute in 10 ms.
    pub(crate) ticks_per_10_ms: u64,
    /// First tick with an invalid output.
    pub(crate) invalid_from: Option<u64>,
    pub(crate) health_interval_ms: u64,
    pub(crate) checkpoint_interval_ticks: u64,
}

/// Number of published messages that a late subscriber can still receive.
pub(crate) const HISTORY: usize = 500;

#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    pub(crate) stage: u32,
    pub(crate) gate: OutputGate<Packet>,
    pub(crate) behaviour: Behaviour,
    pub(crate) alive: bool,
    pub(crate) exit_recorded: bool,
    /// `true` if the process exited because it was stopped.
    pub(crate) retired: bool,
    pub(crate) hung_until_ms: u64,
    pub(crate) next_tick: u64,
    /// Number of ticks that the process and its predecessors have skipped.
    pub(crate) lost: u64,
    pub(crate) decisions: Link<OwnershipDecision>,
    pub(crate) health: Link<ServiceMessage>,
    pub(crate) checkpoints: Link<ServiceMessage>,
    pub(crate) links: Vec<Link<Packet>>,
    pub(crate) history: VecDeque<Packet>,
    /// First tick that has not been published yet.
    pub(crate) published_tick: u64,
    newest_input: Option<u64>,
    reported_ready: bool,
    last_health_ms: u64,
    checkpoint_tick: u64,
}

impl Process {
    pub(crate) fn new(
        incarnation: u32,
        stage: u32,
        gate: OutputGate<Packet>,
        behaviour: Behaviour,
        next_tick: u64,
        links: impl Iterator<Item = u64>,
        rng: &mut SimRng,
    ) -> Self {
        Self {
            incarnation,
            stage,
            gate,
            behaviour,
            alive: true,
            exit_recorded: false,
            retired: false,
            hung_until_ms: 0,
            next_tick,
            lost: 0,
            decisions: Link::new(MAX_DELAY_MS, rng),
            health: Link::new(MAX_DELAY_MS, rng),
            checkpoints: Link::new(MAX_DELAY_MS, rng),
            links: links.map(|longest_ms| Link::new(longest_ms, rng)).collect(),
            history: VecDeque::new(),
            published_tick: 0,
            newest_input: None,
            reported_ready: false,
            last_health_ms: 0,
            checkpoint_tick: next_tick,
        }
    }

    /// Simulates one millisecond. `newest_input` is the newest tick of the input. If `exits` is
    /// set, the process exits during this millisecond.
    pub(crate) fn step(&mut self, now_ms: u64, newest_input: Option<u64>, exits: bool, rng: &mut SimRng) {
        if !self.alive || now_ms < self.hung_until_ms || now_ms < self.behaviour.ready_ms {
            self.alive &= !exits;
            return;
        }
        let mut out = Vec::new();
        self.newest_input = self.newest_input.max(newest_input);
        let decisions_first = rng.chance(700);
        if decisions_first {
            self.apply_decisions(now_ms, &mut out);
        }
        let budget =
            self.behaviour.ticks_per_10_ms / 10 + u64::from(rng.in_range(0, 9) < self.behaviour.ticks_per_10_ms % 10);
        for _ in 0..budget {
            if self.newest_input.is_none_or(|newest| newest < self.next_tick) {
                break;
            }
            let packet = Packet { tick: self.next_tick, epoch: 0, incarnation: 0, stage: self.stage };
            self.gate.push(packet, &mut |packet| out.push(packet));
            self.next_tick += 1;
        }
        if !decisions_first {
            self.apply_decisions(now_ms, &mut out);
        }
        self.send(now_ms, &out, exits, rng);
        if !exits {
            self.publish_health(now_ms, rng);
        }
        self.alive = !exits;
    }

    fn apply_decisions(&mut self, now_ms: u64, out: &mut Vec<Packet>) {
        while let Some(decision) = self.decisions.arrived(now_ms) {
            self.gate.apply(decision, &mut |packet| out.push(packet));
        }
    }

    /// Sends each output to one subscriber after another. If `exits` is set, sending stops at a
    /// random point.
    fn send(&mut self, now_ms: u64, out: &[Packet], exits: bool, rng: &mut SimRng) {
        let all = out.len() * self.links.len();
        let sent = if exits { rng.in_range(0, all as u64) as usize } else { all };
        for index in 0..sent {
            let (packet, link) = (out[index / self.links.len()], index % self.links.len());
            self.links[link].send(now_ms, rng, packet);
            self.published_tick = self.published_tick.max(packet.tick + 1);
            if link + 1 == self.links.len() {
                self.history.push_back(packet);
                if self.history.len() > HISTORY {
                    self.history.pop_front();
                }
            }
        }
    }

    fn publish_health(&mut self, now_ms: u64, rng: &mut SimRng) {
        if !self.reported_ready {
            self.reported_ready = true;
            self.health.send(now_ms, rng, ServiceMessage::Ready);
        }
        if now_ms >= self.last_health_ms + self.behaviour.health_interval_ms {
            self.last_health_ms = now_ms;
            let invalid_output = self.behaviour.invalid_from.is_some_and(|from| self.next_tick > from);
            let (status, progress) = (self.gate.status(), Progress { next_tick: self.next_tick, lost: self.lost });
            self.health.send(now_ms, rng, ServiceMessage::Health { status, progress, invalid_output });
        }
        if self.next_tick >= self.checkpoint_tick + self.behaviour.checkpoint_interval_ticks {
            self.checkpoint_tick = self.next_tick;
            self.checkpoints.send(now_ms, rng, ServiceMessage::Checkpoint { next_tick: self.next_tick });
        }
    }
}
