//! Service of a slot, independent of bus and clock: its stage, ownership, checkpoints and health.
//!
//! - Input: messages and decisions, in the order in which they are handled.
//! - Output: messages to publish, checkpoints and health.
//! - Failure: an invalid checkpoint is reported. The service then starts with the messages that its
//!   inputs still hold.

use bytemuck::Zeroable as _;
use graph::Service;
use messages::{Checkpoint, Control, Flags, Header, Health, Ticked};
use swap::{OutputGate, OwnershipStatus, Resume, Role, Sequence};

use crate::{
    ServiceConfig,
    checkpoint::{self, ResumeError, Resumed},
    comparable::Comparable,
    slot::SlotProcessor,
};

/// Service of a slot: its message processing, output gate and checkpoints.
#[derive(Debug)]
pub struct SlotService<S: SlotProcessor> {
    incarnation: u32,
    checkpoint_ticks: u64,
    slot: S,
    gate: OutputGate<S::Output>,
    /// Set after a swap. While set, every published output carries the flag `SWAPPED`. Cleared
    /// after the first output at or after this tick.
    swapped_at: Option<u64>,
    /// Set if inputs before this tick are missing after a restart. While set, every published
    /// output carries the flag `LOST_BEFORE`. Cleared after the first output at or after this tick,
    /// because subscribers discard earlier outputs as repeated.
    missed_at: Option<u64>,
    /// Next tick of the restored checkpoint. `None` after the first output.
    resumed_tick: Option<u64>,
    /// Tick after the last one that the slot had published before this process started.
    published_end_tick: u64,
    next_checkpoint_tick: u64,
    /// Newest checkpoint; all zeros before the first one.
    checkpoint: Box<Checkpoint>,
    flags: Flags,
    invalid_outputs: u64,
}

impl<S: SlotProcessor> SlotService<S> {
    /// Creates the service with the role and state that `config` specifies.
    ///
    /// All input ticks before `input_tick` and all output ticks before `output_tick` have been
    /// published. The second returned value is the error if a checkpoint could not be restored.
    pub fn new(mut slot: S, config: &ServiceConfig, input_tick: u64, output_tick: u64) -> (Self, Option<ResumeError>) {
        let checkpoint = config.resume.as_ref().and_then(Resume::checkpoint);
        let swapped = checkpoint.is_some_and(|checkpoint| checkpoint.swapped != 0);
        let (resumed, error) = match checkpoint.map(|checkpoint| checkpoint::resume(&mut slot, checkpoint)) {
            Some(Ok(resumed)) => (Some(resumed), None),
            Some(Err(error)) => (None, Some(error)),
            None => (None, None),
        };
        if config.resume.is_some() {
            slot.expect_backlog(input_tick);
        }
        let resumed_tick = resumed.is_some().then(|| slot.sequence().next_tick);
        let ServiceConfig { incarnation, epoch, role, .. } = *config;
        let capacity = config.lateness_ticks() as usize;
        let service = Self {
            incarnation,
            checkpoint_ticks: config.checkpoint_ticks(),
            slot,
            gate: match role {
                Role::Owner { from_tick } => OutputGate::owner(incarnation, epoch, from_tick, capacity),
                Role::Candidate => OutputGate::candidate(incarnation, epoch, capacity),
            },
            swapped_at: match (role, resumed) {
                // The predecessor exited before it published any output as the owner, so no output
                // has been flagged as swapped yet.
                (Role::Owner { from_tick }, Some(Resumed::Complete)) if swapped => Some(from_tick),
                (_, Some(Resumed::Complete)) => None,
                (Role::Candidate, _) => Some(0),
                // Ticks before `output_tick` were published by another stage.
                (Role::Owner { .. }, Some(Resumed::Common)) => Some(output_tick),
                (Role::Owner { .. }, None) => None,
            },
            missed_at: None,
            resumed_tick,
            published_end_tick: output_tick,
            next_checkpoint_tick: 0,
            checkpoint: Box::new(Checkpoint::zeroed()),
            flags: Flags::NONE,
            invalid_outputs: 0,
        };
        (service, error)
    }

    /// Processes a message.
    ///
    /// Passes each completed output to `on_computed`. Outputs of ticks that the service owns are
    /// also passed to `publish`.
    pub fn offer(
        &mut self,
        message: S::Input,
        on_computed: &mut dyn FnMut(&S::Output),
        publish: &mut dyn FnMut(S::Output),
    ) {
        let Self {
            slot, gate, swapped_at, missed_at, resumed_tick, published_end_tick, flags, invalid_outputs, ..
        } = self;
        slot.offer(message, &mut |output| {
            *flags |= output.header().flags;
            *invalid_outputs += u64::from(output.attitude().is_none());
            on_computed(&output);
            let tick = output.header().tick;
            if resumed_tick.take().is_some_and(|resumed_tick| resumed_tick < tick) {
                *missed_at = Some(*published_end_tick);
            }
            gate.push(output, &mut |output| publish(with_flags(output, swapped_at, missed_at)));
        });
    }

    /// Applies a decision. Returns `true` if the decision is new and about this slot.
    pub fn apply_decision(&mut self, control: &Control, publish: &mut dyn FnMut(S::Output)) -> bool {
        let Self { gate, swapped_at, missed_at, .. } = self;
        let Control { epoch, owner, from_tick, service, .. } = *control;
        let decision = swap::OwnershipDecision { epoch, owner, from_tick };
        service == Service::from(S::SLOT) as u32
            && gate.apply(decision, &mut |output| publish(with_flags(output, swapped_at, missed_at))).is_some()
    }

    /// Returns a checkpoint if one is due. It holds the state from which the next tick is computed.
    ///
    /// # Errors
    ///
    /// Returns the cause if the stage has failed permanently.
    pub fn checkpoint(&mut self) -> Result<Option<&Checkpoint>, String> {
        let next_tick = self.slot.sequence().next_tick;
        if next_tick < self.next_checkpoint_tick {
            return Ok(None);
        }
        self.next_checkpoint_tick = next_tick + self.checkpoint_ticks;
        checkpoint::capture(&mut self.slot, self.incarnation, self.swapped_at.is_some(), &mut self.checkpoint);
        self.failure().map_or(Ok(Some(&self.checkpoint)), Err)
    }

    /// Returns the state from which the next tick is computed.
    pub fn state(&mut self) -> Box<Checkpoint> {
        let mut state = Box::new(Checkpoint::zeroed());
        checkpoint::capture(&mut self.slot, self.incarnation, self.swapped_at.is_some(), &mut state);
        state
    }

    /// Fills in the health report, except for the fields that only the bus connection can provide.
    pub fn fill_health(&self, health: &mut Health) {
        let Sequence { ticks, lost, duplicated, repeated, next_tick, .. } = *self.slot.sequence();
        let OwnershipStatus { decided_epoch, missed, published_from, .. } = self.gate.status();
        (health.ticks, health.lost, health.duplicated, health.repeated) = (ticks, lost, duplicated, repeated);
        (health.next_tick, health.flags, health.invalid_outputs) = (next_tick, self.flags, self.invalid_outputs);
        (health.epoch, health.missed) = (decided_epoch, missed.into());
        health.published_from = published_from.unwrap_or(u64::MAX);
    }

    /// Returns the cause if the stage has failed permanently, else `None`.
    pub fn failure(&self) -> Option<String> {
        self.slot.failure()
    }

    /// Returns the number of ticks computed.
    pub fn ticks(&self) -> u64 {
        self.slot.sequence().ticks
    }

    /// Returns the index of the input that the next output is waiting for.
    pub fn awaited_input(&self) -> usize {
        self.slot.awaited_input()
    }

    /// Returns `true` if the slot should wait briefly for the rest of a tick.
    pub fn has_incomplete_tick(&self) -> bool {
        self.slot.has_incomplete_tick()
    }

    /// Returns `true` if the service owns the next tick.
    pub fn owns_next_tick(&self) -> bool {
        self.gate.owns_next_tick()
    }
}

/// Sets the flag `SWAPPED` while `swapped_at` is set, and the flag `LOST_BEFORE` while `missed_at`
/// is set. Clears each of the two after the first output at or after its tick.
fn with_flags<O: Ticked>(mut output: O, swapped_at: &mut Option<u64>, missed_at: &mut Option<u64>) -> O {
    let Header { tick, flags, .. } = output.header_mut();
    *flags |= Flags::SWAPPED.when(swapped_at.is_some()) | Flags::LOST_BEFORE.when(missed_at.is_some());
    let tick = *tick;
    swapped_at.take_if(|from| tick >= *from);
    missed_at.take_if(|from| tick >= *from);
    output
}
