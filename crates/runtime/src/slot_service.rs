//! A slot's service without bus and clock: its work, who owns it, its checkpoints, and what it says of itself.
//!
//! Input: messages and decisions in the order in which they are taken. Output: what is to be published, checkpoints, health. Time: none.
//! Failure: a checkpoint that cannot be taken over is told; the service then begins with what its inputs hold.

use launch::Service;
use messages::{Checkpoint, Control, Flags, Header, Health, Ticked};
use swap::{OutputGate, OwnershipStatus, Role, Sequence};

use crate::{
    ServiceConfig,
    checkpoint::{self, ResumeError, Resumed},
    comparable::Comparable,
    service_config::Resume,
    slot::Slot,
};

/// A slot at work.
#[derive(Debug)]
pub struct SlotService<S: Slot> {
    service: Service,
    incarnation: u32,
    checkpoint_ticks: u64,
    slot: S,
    gate: OutputGate<S::Output>,
    /// What every output says up to the first one at this tick or after it: another stage than before has made it.
    swapped_at: Option<u64>,
    /// The same: inputs are missing before it, of which the readers were not told, since they had the outputs at that time already.
    missed_at: Option<u64>,
    /// The next tick of the checkpoint that it goes on from, until its first output.
    resumed_tick: Option<u64>,
    /// Before this tick the slot has published.
    output_tick: u64,
    next_checkpoint: u64,
    flags: Flags,
    flawed: u64,
}

impl<S: Slot> SlotService<S> {
    /// Begins as `config` says. Before `input_tick` every input has been published; before `output_tick` so has the slot itself. What
    /// could not be taken over comes with it.
    pub fn new(
        mut slot: S,
        service: Service,
        config: &ServiceConfig,
        input_tick: u64,
        output_tick: u64,
    ) -> (Self, Option<ResumeError>) {
        let record = match &config.resume {
            Some(Resume::Checkpoint(record)) => Some(record.checkpoint()),
            _ => None,
        };
        let swapped = record.flatten().is_some_and(|checkpoint| checkpoint.swapped != 0);
        let (resumed, error) = match &record {
            Some(checkpoint) => {
                let checkpoint = checkpoint.as_ref().ok_or(ResumeError::Damaged);
                match checkpoint.and_then(|checkpoint| checkpoint::resume(&mut slot, service, checkpoint)) {
                    Ok(resumed) => (Some(resumed), None),
                    Err(error) => (None, Some(error)),
                }
            }
            None => (None, None),
        };
        if config.resume.is_some() {
            slot.expect_until(input_tick);
        }
        let resumed_tick = resumed.is_some().then(|| slot.sequence().next_tick);
        let ServiceConfig { incarnation, epoch, role, .. } = *config;
        let capacity = config.lateness_ticks() as usize;
        let service = Self {
            service,
            incarnation,
            checkpoint_ticks: config.checkpoint_ticks(),
            slot,
            gate: match role {
                Role::Owner { from_tick } => OutputGate::owner(incarnation, epoch, from_tick, capacity),
                Role::Candidate => OutputGate::candidate(incarnation, epoch, capacity),
            },
            swapped_at: match (role, resumed) {
                // It ended before it had published the first output of its own.
                (Role::Owner { from_tick }, Some(Resumed::Whole)) if swapped => Some(from_tick),
                (_, Some(Resumed::Whole)) => None,
                (Role::Candidate, _) => Some(0),
                // What comes before has been published by another stage.
                (Role::Owner { .. }, Some(Resumed::Common)) => Some(output_tick),
                (Role::Owner { .. }, None) => None,
            },
            missed_at: None,
            resumed_tick,
            output_tick,
            next_checkpoint: 0,
            flags: Flags::NONE,
            flawed: 0,
        };
        (service, error)
    }

    /// Takes a message: hands every output that has become certain to `computed`, and what the service owns to `publish`.
    pub fn offer(
        &mut self,
        message: S::Input,
        computed: &mut dyn FnMut(&S::Output),
        publish: &mut dyn FnMut(S::Output),
    ) {
        let Self { slot, gate, swapped_at, missed_at, resumed_tick, output_tick, flags, flawed, .. } = self;
        slot.offer(message, &mut |output| {
            *flags |= output.header().flags;
            *flawed += u64::from(output.attitude().is_none());
            computed(&output);
            let tick = output.header().tick;
            if resumed_tick.take().is_some_and(|resumed_tick| resumed_tick < tick) {
                *missed_at = Some(*output_tick);
            }
            gate.take(output, &mut |output| publish(marked(output, swapped_at, missed_at)));
        });
    }

    /// Follows a decision; whether it was one about this slot that is new.
    pub fn decide(&mut self, control: &Control, publish: &mut dyn FnMut(S::Output)) -> bool {
        let Self { gate, swapped_at, missed_at, .. } = self;
        let Control { epoch, owner, from_tick, service, .. } = *control;
        let decision = swap::Control { epoch, owner, from_tick };
        service == self.service as u32
            && gate.decide(decision, &mut |output| publish(marked(output, swapped_at, missed_at))).is_some()
    }

    /// The checkpoint, every so many ticks.
    pub fn checkpoint(&mut self) -> Option<Checkpoint> {
        let next_tick = self.slot.sequence().next_tick;
        if next_tick < self.next_checkpoint {
            return None;
        }
        self.next_checkpoint = next_tick + self.checkpoint_ticks;
        Some(self.state())
    }

    /// The state before the tick that it takes next.
    pub fn state(&mut self) -> Checkpoint {
        checkpoint::checkpoint(&mut self.slot, self.service, self.incarnation, self.swapped_at.is_some())
    }

    /// How it is, but for what only the bus knows.
    pub fn describe(&self, health: &mut Health) {
        let Sequence { ticks, lost, duplicated, repeated, next_tick, .. } = *self.slot.sequence();
        let OwnershipStatus { decided_epoch, missed, published_from, .. } = self.gate.status();
        (health.ticks, health.lost, health.duplicated, health.repeated) = (ticks, lost, duplicated, repeated);
        (health.next_tick, health.flags, health.flawed) = (next_tick, self.flags, self.flawed);
        (health.epoch, health.missed) = (decided_epoch, missed.into());
        health.published_from = published_from.unwrap_or(u64::MAX);
    }

    /// Why the stage cannot go on, where it cannot.
    pub fn failure(&self) -> Option<String> {
        self.slot.failure()
    }

    /// Ticks given out so far.
    pub fn ticks(&self) -> u64 {
        self.slot.sequence().ticks
    }

    /// The input that the next output waits for.
    pub fn lacks(&self) -> usize {
        self.slot.lacks()
    }

    /// Whether the next tick would be published.
    pub fn publishes(&self) -> bool {
        self.gate.publishes()
    }
}

/// An output that is published, which says whether another stage than before has made it, and whether inputs are missing.
fn marked<O: Ticked>(mut output: O, swapped_at: &mut Option<u64>, missed_at: &mut Option<u64>) -> O {
    let Header { tick, flags, .. } = output.header_mut();
    *flags |= Flags::SWAPPED.when(swapped_at.is_some()) | Flags::LOST_BEFORE.when(missed_at.is_some());
    let tick = *tick;
    swapped_at.take_if(|from| tick >= *from);
    missed_at.take_if(|from| tick >= *from);
    output
}
