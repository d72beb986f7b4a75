//! A service of the slot: computes what its input allows, obeys decisions, can hang, fail and die between any two messages.

use std::collections::VecDeque;

use swap::{Control, OutputGate, OwnershipStatus, Stamped};

use crate::chance::{Chance, DELAY_MS, Link};

/// An output. What it says is a function of the stage and the tick.
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

/// What a service says to the supervisor.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Word {
    Ready,
    Health { status: OwnershipStatus, flawed: bool },
    Checkpoint { next_tick: u64 },
}

/// How a process behaves.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Manner {
    /// When it opens its topics.
    pub(crate) ready_ms: u64,
    /// Ticks that it can compute in 10 ms.
    pub(crate) ticks_per_10_ms: u64,
    /// The tick from which on its outputs are flawed.
    pub(crate) flawed_from: Option<u64>,
    pub(crate) health_interval_ms: u64,
    pub(crate) checkpoint_interval_ticks: u64,
}

/// Published messages that a reader which joins late still gets.
pub(crate) const HISTORY: usize = 500;

#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) incarnation: u32,
    pub(crate) stage: u32,
    pub(crate) gate: OutputGate<Packet>,
    pub(crate) manner: Manner,
    pub(crate) alive: bool,
    pub(crate) buried: bool,
    /// Ended because it was to end.
    pub(crate) retired: bool,
    pub(crate) hung_until_ms: u64,
    pub(crate) next_tick: u64,
    pub(crate) controls: Link<Control>,
    pub(crate) words: Link<Word>,
    pub(crate) checkpoints: Link<Word>,
    pub(crate) outlets: Vec<Link<Packet>>,
    pub(crate) history: VecDeque<Packet>,
    /// Beyond this tick nothing has been published.
    pub(crate) published_tick: u64,
    newest_input: Option<u64>,
    said_ready: bool,
    said_ms: u64,
    kept_tick: u64,
}

impl Process {
    pub(crate) fn new(
        incarnation: u32,
        stage: u32,
        gate: OutputGate<Packet>,
        manner: Manner,
        next_tick: u64,
        outlets: impl Iterator<Item = u64>,
        chance: &mut Chance,
    ) -> Self {
        Self {
            incarnation,
            stage,
            gate,
            manner,
            alive: true,
            buried: false,
            retired: false,
            hung_until_ms: 0,
            next_tick,
            controls: Link::new(DELAY_MS, chance),
            words: Link::new(DELAY_MS, chance),
            checkpoints: Link::new(DELAY_MS, chance),
            outlets: outlets.map(|longest_ms| Link::new(longest_ms, chance)).collect(),
            history: VecDeque::new(),
            published_tick: 0,
            newest_input: None,
            said_ready: false,
            said_ms: 0,
            kept_tick: next_tick,
        }
    }

    /// One millisecond. `newest_input` is the newest tick of its input; `dies` ends it in the midst of its work.
    pub(crate) fn step(&mut self, now_ms: u64, newest_input: Option<u64>, dies: bool, chance: &mut Chance) {
        if !self.alive || now_ms < self.hung_until_ms || now_ms < self.manner.ready_ms {
            self.alive &= !dies;
            return;
        }
        let mut out = Vec::new();
        self.newest_input = self.newest_input.max(newest_input);
        let controls_first = chance.happens(700);
        if controls_first {
            self.obey(now_ms, &mut out);
        }
        let budget =
            self.manner.ticks_per_10_ms / 10 + u64::from(chance.between(0, 9) < self.manner.ticks_per_10_ms % 10);
        for _ in 0..budget {
            if self.newest_input.is_none_or(|newest| newest < self.next_tick) {
                break;
            }
            let packet = Packet { tick: self.next_tick, epoch: 0, incarnation: 0, stage: self.stage };
            self.gate.take(packet, &mut |packet| out.push(packet));
            self.next_tick += 1;
        }
        if !controls_first {
            self.obey(now_ms, &mut out);
        }
        self.send(now_ms, &out, dies, chance);
        if !dies {
            self.publish_health(now_ms, chance);
        }
        self.alive = !dies;
    }

    fn obey(&mut self, now_ms: u64, out: &mut Vec<Packet>) {
        while let Some(control) = self.controls.arrived(now_ms) {
            self.gate.decide(control, &mut |packet| out.push(packet));
        }
    }

    /// A message goes to one reader after the other; death can come between.
    fn send(&mut self, now_ms: u64, out: &[Packet], dies: bool, chance: &mut Chance) {
        let all = out.len() * self.outlets.len();
        let sent = if dies { chance.between(0, all as u64) as usize } else { all };
        for index in 0..sent {
            let (packet, outlet) = (out[index / self.outlets.len()], index % self.outlets.len());
            self.outlets[outlet].send(now_ms, chance, packet);
            self.published_tick = self.published_tick.max(packet.tick + 1);
            if outlet + 1 == self.outlets.len() {
                self.history.push_back(packet);
                if self.history.len() > HISTORY {
                    self.history.pop_front();
                }
            }
        }
    }

    fn publish_health(&mut self, now_ms: u64, chance: &mut Chance) {
        if !self.said_ready {
            self.said_ready = true;
            self.words.send(now_ms, chance, Word::Ready);
        }
        if now_ms >= self.said_ms + self.manner.health_interval_ms {
            self.said_ms = now_ms;
            let flawed = self.manner.flawed_from.is_some_and(|from| self.next_tick > from);
            let status = self.gate.status();
            self.words.send(now_ms, chance, Word::Health { status, flawed });
        }
        if self.next_tick >= self.kept_tick + self.manner.checkpoint_interval_ticks {
            self.kept_tick = self.next_tick;
            self.checkpoints.send(now_ms, chance, Word::Checkpoint { next_tick: self.next_tick });
        }
    }
}
