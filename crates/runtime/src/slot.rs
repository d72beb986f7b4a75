//! Message processing of a slot, in tick order and independent of clock and bus.

use attitude::{
    stage::{Stage, Validate},
    state_words::StateWords,
    validated_stage::ValidatedStage,
};
use launch::Slot;
use messages::{Header, Ticked};
use swap::Sequence;

use crate::comparable::Comparable;

/// Message processing of a slot. Outputs depend only on the messages that were offered.
pub trait SlotProcessor {
    /// Slot that runs the stage.
    const SLOT: Slot;

    /// Message from any of the slot's inputs.
    type Input;
    /// Message that the slot publishes.
    type Output: Ticked + Comparable;
    /// Stage that runs in the slot.
    type Stage: Stage<Common: StateWords> + Clone;

    /// Processes a message. Calls `publish` with each output that is now complete.
    ///
    /// There are no further outputs once the stage has failed.
    fn offer(&mut self, input: Self::Input, publish: &mut dyn FnMut(Self::Output));

    /// Returns the position and counters of the output stream.
    fn sequence(&self) -> &Sequence;

    /// Returns the index of the input that the next output is waiting for.
    fn awaited_input(&self) -> usize {
        0
    }

    /// Returns `true` if the service should wait briefly for the awaited input before it sleeps,
    /// because the rest of a tick is about to arrive.
    ///
    /// By default, the service sleeps at once. A slot with several inputs may override this method.
    fn has_incomplete_tick(&self) -> bool {
        false
    }

    /// Returns the cause if the stage has failed permanently, else `None`.
    fn failure(&self) -> Option<String>;

    /// Returns the stage that runs in the slot.
    fn stage(&self) -> &Self::Stage;

    /// Returns a mutable reference to the stage, for restoring its state.
    fn stage_mut(&mut self) -> &mut Self::Stage;

    /// Visits the slot's own persistent state, excluding the stage and queued messages.
    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64));

    /// Returns the problem with the slot's own restored state, or `None` if the state is valid.
    fn validation_error(&self) -> Option<&'static str> {
        None
    }

    /// Returns `true` once the stage has determined its state. Until then, the common state has the
    /// initial value, which is the same for every stage.
    fn is_initialised(&self) -> bool {
        true
    }

    /// Declares that all input ticks before `tick` have been published. The slot then waits longer
    /// for those that have not arrived yet.
    fn expect_backlog(&mut self, _tick: u64) {}
}

/// Message processing of a slot that has one input and produces one output per input message.
pub trait TickProcessor {
    /// Slot that runs the stage.
    const SLOT: Slot;

    /// Message that the slot receives.
    type Input: Ticked;
    /// Message that the slot publishes.
    type Output: Ticked + Comparable;
    /// Stage that runs in the slot.
    type Stage: Stage<Common: StateWords, Output: Validate> + Clone;

    /// Processes one tick. Returns `None` once the stage has failed.
    ///
    /// `header` is the header for the output: that of the input, with the flag `LOST_BEFORE` set if
    /// ticks before it are missing.
    fn process(&mut self, input: &Self::Input, header: Header) -> Option<Self::Output>;

    /// Returns the stage with the validation of its outputs.
    fn validated_stage(&self) -> &ValidatedStage<Self::Stage>;

    /// Returns a mutable reference to the stage with the validation of its outputs, for restoring
    /// its state.
    fn validated_stage_mut(&mut self) -> &mut ValidatedStage<Self::Stage>;

    /// Visits the persistent state, excluding the stage.
    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64));
}

/// Slot with one input, processed in tick order.
#[derive(Debug)]
pub struct SingleInputSlot<P> {
    processor: P,
    sequence: Sequence,
}

impl<P> SingleInputSlot<P> {
    /// Creates a slot that runs `processor`.
    pub fn new(processor: P) -> Self {
        Self { processor, sequence: Sequence::default() }
    }
}

impl<P: TickProcessor> SlotProcessor for SingleInputSlot<P> {
    const SLOT: Slot = P::SLOT;

    type Input = P::Input;
    type Output = P::Output;
    type Stage = P::Stage;

    fn offer(&mut self, input: P::Input, publish: &mut dyn FnMut(P::Output)) {
        if let Some(missing) = self.sequence.admit(input.header()) {
            let header = self.sequence.mark_header(*input.header(), missing);
            if let Some(output) = self.processor.process(&input, header) {
                publish(output);
            }
        }
    }

    fn failure(&self) -> Option<String> {
        self.processor.validated_stage().failure().map(|failure| failure.to_string())
    }

    fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    fn stage(&self) -> &P::Stage {
        &self.processor.validated_stage().stage
    }

    fn stage_mut(&mut self) -> &mut P::Stage {
        &mut self.processor.validated_stage_mut().stage
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.sequence.visit(visit);
        self.processor.visit_own_state(visit);
    }
}

/// Defines the message of a slot with several inputs: an enum with a variant for each topic.
#[macro_export]
macro_rules! slot_messages {
    ($name:ident { $($variant:ident($message:ty),)* }) => {
        /// Message received on one of the slot's inputs.
        #[derive(Debug, Clone, Copy)]
        pub enum $name {
            $(
                #[doc = concat!("Message of type `", stringify!($message), "`.")]
                $variant($message),
            )*
        }

        $(impl From<$message> for $name {
            fn from(message: $message) -> Self {
                Self::$variant(message)
            }
        })*
    };
}
