//! The loop around a slot's work: who reads what, in which order, until when.
//!
//! Input: messages of the topics that a slot reads. Output: one message per tick, in order. Time: stamps and waits only; what a slot
//! makes of its inputs never depends on a clock. Failure: a tick that never comes is counted and said; an input that stays away is
//! left out once another is far enough ahead.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`slot`] | a slot's work without clock or bus |
//! | [`state_words`], [`checkpoint`] | the state of a slot, and how another process goes on from it |
//! | [`join`] | several inputs in the order of ticks |
//! | [`prior`] | what is known of the sensors before the first sample |
//! | [`quantities`] | what messages mean in the mathematics |
//! | [`frames`] | messages in the frame of others |
//! | [`service_config`] | what a service is told at its start, and what follows from it |
//! | [`stderr_tail`] | what it says on standard error |
//! | [`service_context`] | a service's place in a running system |
//! | [`reader`] | a topic as a slot reads it |
//! | [`slot_service`] | a slot's service without bus and clock: its work, who owns it, its checkpoints |
//! | [`turns`] | which input a slot looks at next |
//! | [`service`] | the loop over the bus |
//! | [`comparable`] | what of two outputs can be compared |
//! | [`shadow`] | a candidate beside the stage that owns the slot |
//! | [`stage`] | filling a slot with what the launch file names |
//! | [`clock`] | the monotonic clock, and the time of processors |
#![forbid(unsafe_code)]

pub mod checkpoint;
pub mod clock;
pub mod comparable;
mod error;
pub mod frames;
pub mod join;
pub mod prior;
pub mod quantities;
pub mod reader;
pub mod service;
pub mod service_config;
pub mod service_context;
pub mod shadow;
pub mod slot;
pub mod slot_service;
pub mod stage;
pub mod state_words;
pub mod stderr_tail;
pub mod turns;

pub use error::RuntimeError;
pub use join::{Join, Joined, Lane, Lanes};
pub use prior::{Known, Prior};
pub use reader::{Input, Reader};
pub use service::serve;
pub use service_config::{Pace, Role, ServiceConfig};
pub use service_context::ServiceContext;
pub use slot::{EachTick, Slot, Work};
pub use swap::Sequence;

/// Longest interval over which two rates still tell how far the body turned, s. Over a longer one the level is set anew.
pub const BRIDGE_S: f64 = 1.0;
