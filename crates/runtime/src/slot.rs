//! A slot's work without clock or bus: messages in, messages out, in the order of ticks.

use attitude::stage::Stage;
use messages::{Flags, Header, Ticked};

use crate::{shadow::Comparable, words::Words};

/// The work of a slot. What it gives out depends on what it was offered, and on nothing else.
pub trait Slot {
    /// Any message that it reads.
    type Input;
    /// What it publishes.
    type Output: Ticked + Comparable;
    /// What fills it.
    type Stage: Stage<Common: Words> + Clone;

    /// Takes a message; hands every output that has become certain to `publish`.
    fn offer(&mut self, input: Self::Input, publish: &mut dyn FnMut(Self::Output));

    /// The stream it gives out, so far.
    fn sequence(&self) -> &Sequence;

    /// Which of its inputs the next output waits for: the one to sleep for.
    fn lacks(&self) -> usize {
        0
    }

    /// The stage.
    fn stage(&self) -> &Self::Stage;

    /// The stage, to be given a state.
    fn stage_mut(&mut self) -> &mut Self::Stage;

    /// Hands every word to `visit` that the next output depends on, beside the stage and the messages that wait for their turn.
    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64));

    /// What is wrong with those words.
    fn own_flaw(&self) -> Option<&'static str> {
        None
    }

    /// What the stage tells as common is more than where every stage begins.
    fn has_begun(&self) -> bool {
        true
    }

    /// Before `tick` everything has been published once: what is missing is on its way, however far another input is ahead.
    fn expect_until(&mut self, _tick: u64) {}
}

/// The work of a slot with one input: one message out for each message in.
pub trait Work {
    /// What it reads.
    type Input: Ticked;
    /// What it publishes.
    type Output: Ticked + Comparable;
    /// What does it.
    type Stage: Stage<Common: Words> + Clone;

    /// The work of one tick. `header` is the output's, with what the input said; ticks missing before it are flagged.
    fn work(&mut self, input: &Self::Input, header: Header) -> Self::Output;

    /// The stage.
    fn stage(&self) -> &Self::Stage;

    /// The stage, to be given a state.
    fn stage_mut(&mut self) -> &mut Self::Stage;

    /// Hands every word to `visit` that the next output depends on, beside the stage.
    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64));
}

/// A slot with one input, which it takes in the order of ticks.
#[derive(Debug, Clone)]
pub struct EachTick<W> {
    work: W,
    sequence: Sequence,
}

impl<W> EachTick<W> {
    /// The slot that does this work.
    pub fn new(work: W) -> Self {
        Self { work, sequence: Sequence::default() }
    }
}

impl<W: Work> Slot for EachTick<W> {
    type Input = W::Input;
    type Output = W::Output;
    type Stage = W::Stage;

    fn offer(&mut self, input: W::Input, publish: &mut dyn FnMut(W::Output)) {
        if let Some(missing) = self.sequence.admit(input.header()) {
            let header = self.sequence.mark(*input.header(), missing);
            publish(self.work.work(&input, header));
        }
    }

    fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    fn stage(&self) -> &W::Stage {
        self.work.stage()
    }

    fn stage_mut(&mut self) -> &mut W::Stage {
        self.work.stage_mut()
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.sequence.visit(visit);
        self.work.visit_own(visit);
    }
}

/// A stream in the order of ticks: what is next, what is missing, what came again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sequence {
    /// The tick that comes next when nothing is lost.
    pub next_tick: u64,
    /// Ticks in the stream.
    pub ticks: u64,
    /// Ticks that never came.
    pub lost: u64,
    /// Messages left out because they came again, or too late.
    pub duplicated: u64,
    /// Messages left out because another life of their sender had sent them already.
    pub repeated: u64,
    /// The life that sent the last tick; 0 before the first.
    pub sender: u32,
}

impl Sequence {
    /// Admits a tick to the stream and tells how many before it are missing; `None` for one that has had its turn.
    pub fn admit(&mut self, header: &Header) -> Option<u64> {
        let Some(missing) = header.tick.checked_sub(self.next_tick) else {
            self.refuse(header.incarnation, self.sender);
            return None;
        };
        self.lost += missing;
        self.ticks += 1;
        self.next_tick = header.tick.saturating_add(1);
        self.sender = header.incarnation;
        Some(missing)
    }

    /// Leaves out a message whose tick has had its turn: what a new life says again is no fault.
    pub(crate) fn refuse(&mut self, sender: u32, usual: u32) {
        let count = if sender == usual { &mut self.duplicated } else { &mut self.repeated };
        *count += 1;
    }

    /// A header of the tick just admitted that says what is missing before it.
    pub fn mark(&self, header: Header, missing: u64) -> Header {
        let flags = header.flags | Flags::LOST_BEFORE.when(missing > 0);
        Header { lost_upstream: self.lost, flags, ..header }
    }
}
