//! Swap of the stage in a slot of a running system: ownership, delivery to subscribers, and
//! coordination.
//!
//! - Input, output: messages, decisions and events as plain values.
//! - Time: subscribers and services decide by ticks alone. Only the coordinator has deadlines, and
//!   its caller passes the time.
//! - Failure: a failed swap returns the slot to the previous stage.
//!
//! | module | runs in | purpose |
//! | --- | --- | --- |
//! | [`output_gate`] | each service | publishes or holds back the outputs of the stage |
//! | [`reorder_buffer`] | each subscriber | merges all publishers into one ordered stream |
//! | [`sequence`] | each subscriber | counts missing and repeated ticks |
//! | [`coordinator`] | the supervisor, per slot | swaps the stage and decides the owner of each tick |
//! | [`event`] | between coordinator and supervisor | events, actions and reports |
//!
//! One rule decides ownership: *a tick belongs to the owner named by the decision of the highest
//! epoch that starts at or before it.*
//!
//! No tick is lost if the system guarantees the following:
//! - The messages of one publisher arrive in order, even if the publisher has exited. Messages of
//!   different publishers may arrive in any order.
//! - [`OutputGate`] and [`ReorderBuffer`] hold more ticks than the source produces in
//!   `commit_timeout_ms`, in the delivery time of a decision, and in the margin.
//! - A service restarts from a checkpoint that [`Coordinator::admits_checkpoint`] accepted, and its
//!   inputs still hold the ticks from there on.
//! - A restarted subscriber finds its missing ticks at living publishers. Therefore a stage
//!   restarts from a checkpoint no newer than those of its subscribers, and the coordinator
//!   receives theirs ([`Event::SubscribersCheckpointed`]) before it retires the previous stage.
#![forbid(unsafe_code)]

pub mod coordinator;
pub mod event;
pub mod output_gate;
pub mod reorder_buffer;
pub mod sequence;

use messages::Ticked;
use serde::{Deserialize, Serialize};

pub use coordinator::{Coordinator, SwapState};
pub use event::{Action, Event, FailureReason, Report, Request, SwapLimits, SwapOutcome};
pub use output_gate::{DecisionResponse, OutputGate};
pub use reorder_buffer::ReorderBuffer;
pub use sequence::Sequence;

/// Epoch of the supervisor's first decisions, which assign each slot to the stage in the launch
/// file.
pub const FIRST_EPOCH: u32 = 1;

/// Initial role of a service in its slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Publishes from a tick on.
    Owner {
        /// First published tick.
        from_tick: u64,
    },
    /// Computes in parallel with the owner until a decision names it.
    Candidate,
}

/// Decision about the ownership of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OwnershipDecision {
    /// Number of the decision; increases with every decision about the slot.
    pub epoch: u32,
    /// Incarnation that owns the slot; 0 for none.
    pub owner: u32,
    /// First tick of the owner.
    pub from_tick: u64,
}

/// Ownership state of a service, as its health reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct OwnershipStatus {
    /// Next tick to compute.
    pub next_tick: u64,
    /// Epoch of the last decision that the service handled.
    pub decided_epoch: u32,
    /// Whether that decision came too late and changed nothing.
    pub missed: bool,
    /// First tick published under that decision.
    pub published_from: Option<u64>,
}

/// A message with the fields that decide its order and ownership.
pub trait Stamped {
    /// Returns the tick of the message.
    fn tick(&self) -> u64;
    /// Returns the epoch of the decision under which the message was published.
    fn epoch(&self) -> u32;
    /// Returns the incarnation of the publisher.
    fn incarnation(&self) -> u32;
    /// Sets publisher and epoch.
    fn stamp(&mut self, epoch: u32, incarnation: u32);
}

impl<M: Ticked> Stamped for M {
    fn tick(&self) -> u64 {
        self.header().tick
    }

    fn epoch(&self) -> u32 {
        self.header().epoch
    }

    fn incarnation(&self) -> u32 {
        self.header().incarnation
    }

    fn stamp(&mut self, epoch: u32, incarnation: u32) {
        (self.header_mut().epoch, self.header_mut().incarnation) = (epoch, incarnation);
    }
}
