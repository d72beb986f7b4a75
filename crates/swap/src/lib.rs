//! Swaps of the stage in a slot of a running system: ownership, delivery to subscribers, and
//! coordination.
//!
//! - Input, output: messages, decisions and events as plain values.
//! - Time: the decisions of subscribers and services depend only on ticks. Only the coordinator has
//!   deadlines, and its caller passes in the time.
//! - Failure: a failed swap returns the slot to the previous stage.
//!
//! | module | runs in | purpose |
//! | --- | --- | --- |
//! | [`output_gate`] | each service | publishes or holds back the outputs of the stage |
//! | [`reorder_buffer`] | each subscriber | merges all publishers into one ordered stream |
//! | [`sequence`] | each subscriber | counts missing and repeated ticks |
//! | [`coordinator`] | supervisor, per slot | swaps the stage and decides the owner of each tick |
//! | [`event`] | between coordinator and supervisor | events, actions and reports |
//!
//! One rule decides ownership: *Of all decisions with a first tick of t or earlier, the one with
//! the highest epoch names the owner of the slot at tick t.*
//!
//! No tick is lost if the system guarantees the following:
//! - The messages of one publisher arrive in order, even if the publisher has exited. Messages of
//!   different publishers may arrive in any order.
//! - [`OutputGate`] and [`ReorderBuffer`] hold more ticks than the source produces in the sum of
//!   `commit_timeout_ms`, the delivery time of a decision, and the margin.
//! - A service restarts from a checkpoint that [`Coordinator::admits_checkpoint`] accepted, and its
//!   inputs still hold the ticks from this checkpoint on.
//! - A restarted subscriber can read its missing ticks from running publishers. Therefore a stage
//!   restarts from a checkpoint no newer than those of its subscribers, and the coordinator is
//!   notified of their checkpoints ([`Event::SubscribersCheckpointed`]) before it retires the
//!   previous stage.
#![forbid(unsafe_code)]

pub mod coordinator;
pub mod event;
pub mod output_gate;
pub mod reorder_buffer;
mod resume;
pub mod sequence;

use messages::Ticked;
use serde::{Deserialize, Serialize};

pub use coordinator::{Coordinator, SwapState};
pub use event::{Action, Event, FailureReason, Progress, Report, Request, SwapLimits, SwapOutcome};
pub use output_gate::{DecisionResponse, OutputGate};
pub use reorder_buffer::ReorderBuffer;
pub use resume::Resume;
pub use sequence::Sequence;

/// Epoch of the supervisor's first decisions, which assign each slot to its stage in the launch
/// file.
pub const FIRST_EPOCH: u32 = 1;

/// Initial role of a service in its slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// The service owns its slot and publishes from a given tick on.
    Owner {
        /// First published tick.
        from_tick: u64,
    },
    /// The service computes in parallel with the owner until a decision names it as the owner.
    Candidate,
}

/// Decision about the ownership of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OwnershipDecision {
    /// Number of the decision, which increases with every decision about the slot.
    pub epoch: u32,
    /// Incarnation that owns the slot; 0 if there is no owner.
    pub owner: u32,
    /// First tick of the owner.
    pub from_tick: u64,
}

/// Ownership state of a service, as included in its health report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct OwnershipStatus {
    /// Next tick to compute.
    pub next_tick: u64,
    /// Epoch of the last decision that the service handled.
    pub decided_epoch: u32,
    /// `true` if the decision of `decided_epoch` came too late and changed nothing.
    pub missed: bool,
    /// First tick published under the decision of `decided_epoch`.
    pub published_from: Option<u64>,
}

/// Message with the fields that determine its order and ownership.
pub trait Stamped {
    /// Returns the tick of the message.
    fn tick(&self) -> u64;
    /// Returns the epoch of the decision under which the message was published.
    fn epoch(&self) -> u32;
    /// Returns the incarnation of the publisher.
    fn incarnation(&self) -> u32;
    /// Sets the epoch and the incarnation of the publisher.
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
