//! The swap of the stage in a slot of a running system: who publishes, what a reader takes, who decides.
//!
//! Input, output: messages, decisions and events as plain values. Time: a reader and a service decide by ticks alone; only the
//! coordinator has deadlines, on a clock that is told to it. Failure: a swap that fails gives the slot back to the stage that had it.
//!
//! | module | where it lives | what it does |
//! | --- | --- | --- |
//! | [`output_gate`] | in each service | publishes, or keeps, what the stage gives out |
//! | [`reorder_buffer`] | at each reader of a topic | makes one stream of all that publish it: each tick once, in order |
//! | [`sequence`] | at each reader | counts what is missing and what came again |
//! | [`coordinator`] | in the supervisor, one for each slot | starts the candidate, decides who owns the slot from which tick, ends who does not |
//! | [`event`] | between coordinator and supervisor | what happens, what is to be done, how it went |
//!
//! The rule for all: *a tick belongs to the owner named by the decision of the highest epoch that begins at or before it.*
//!
//! What the system must add so that no tick is lost:
//! - A publisher's messages arrive in order, and what it has sent arrives although it has died. Across publishers any order will do.
//! - [`OutputGate`] and [`ReorderBuffer`] keep more ticks than the source can give in `commit_ms` and the time a decision takes to arrive, plus the margin.
//! - A service restarts from a checkpoint that [`Coordinator::admits`], and its input reaches back to it.
//! - A reader that restarts finds what it lacks at publishers that live: a stage restarts from a checkpoint that is no newer than its
//!   readers', and the coordinator hears of theirs ([`Event::ReadersKeep`]) before it retires the old stage.
#![forbid(unsafe_code)]

pub mod coordinator;
pub mod event;
pub mod output_gate;
pub mod reorder_buffer;
pub mod sequence;

use messages::Ticked;
use serde::{Deserialize, Serialize};

pub use coordinator::{Coordinator, State};
pub use event::{Action, Event, Limits, Outcome, Reason, Report, Request};
pub use output_gate::{Answer, OutputGate};
pub use reorder_buffer::ReorderBuffer;
pub use sequence::Sequence;

/// The supervisor's first decision: every slot belongs to whom `launch.toml` names.
pub const FIRST_EPOCH: u32 = 1;

/// Whether a service begins as the owner of its slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// It publishes from this tick on.
    Owner {
        /// The first tick.
        from_tick: u64,
    },
    /// It computes beside the owner until a decision names it.
    Candidate,
}

/// A decision about a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Control {
    /// Its number; grows with every decision about the slot.
    pub epoch: u32,
    /// The incarnation that owns the slot.
    pub owner: u32,
    /// The first tick that it owns.
    pub from_tick: u64,
}

/// How a service stands to its slot, as its health says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct OwnershipStatus {
    /// The tick that it computes next.
    pub next_tick: u64,
    /// The last decision that it answered.
    pub decided_epoch: u32,
    /// It could not do what that decision asked, and goes on as before.
    pub missed: bool,
    /// The first tick that it has published under that decision.
    pub published_from: Option<u64>,
}

/// A message of a slot: what its order and its owner are read from.
pub trait Stamped {
    /// The tick that it comes from.
    fn tick(&self) -> u64;
    /// The decision under which it was published.
    fn epoch(&self) -> u32;
    /// The incarnation of its publisher.
    fn incarnation(&self) -> u32;
    /// Writes the publisher and the decision into it.
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
