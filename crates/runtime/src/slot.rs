//! A slot's work without clock or bus: messages in, messages out, in the order of ticks.

use attitude::stage::{Sound, Stage};
use messages::{Header, Ticked};
use swap::Sequence;

use crate::{comparable::Comparable, stage::Filled, state_words::Words};

/// The work of a slot. What it gives out depends on what it was offered, and on nothing else.
pub trait Slot {
    /// Any message that it reads.
    type Input;
    /// What it publishes.
    type Output: Ticked + Comparable;
    /// What fills it.
    type Stage: Stage<Common: Words> + Clone;

    /// Takes a message; hands every output that has become certain to `publish`, as long as its stage can go on.
    fn offer(&mut self, input: Self::Input, publish: &mut dyn FnMut(Self::Output));

    /// The stream it gives out, so far.
    fn sequence(&self) -> &Sequence;

    /// Which of its inputs the next output waits for: the one to sleep for.
    fn lacks(&self) -> usize {
        0
    }

    /// Why nothing more comes of it: its stage cannot go on.
    fn failure(&self) -> Option<String>;

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
    type Stage: Stage<Common: Words, Output: Sound> + Clone;

    /// The work of one tick; `None` where the stage cannot go on. `header` is the output's, with what the input said; ticks missing before it
    /// are flagged.
    fn work(&mut self, input: &Self::Input, header: Header) -> Option<Self::Output>;

    /// The stage in the slot.
    fn filled(&self) -> &Filled<Self::Stage>;

    /// The same, to be given a state.
    fn filled_mut(&mut self) -> &mut Filled<Self::Stage>;

    /// Hands every word to `visit` that the next output depends on, beside the stage.
    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64));
}

/// A slot with one input, which it takes in the order of ticks.
#[derive(Debug)]
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
            if let Some(output) = self.work.work(&input, header) {
                publish(output);
            }
        }
    }

    fn failure(&self) -> Option<String> {
        self.work.filled().failure()
    }

    fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    fn stage(&self) -> &W::Stage {
        &self.work.filled().stage
    }

    fn stage_mut(&mut self) -> &mut W::Stage {
        &mut self.work.filled_mut().stage
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.sequence.visit(visit);
        self.work.visit_own(visit);
    }
}
