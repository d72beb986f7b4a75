//! The loop around a slot's work: who reads what, in which order, until when.
//!
//! Input: messages of the topics that a slot reads. Output: one message per tick, in order. Time: stamps and waits only; what a slot
//! makes of its inputs never depends on a clock. Failure: a tick that never comes is counted and said; an input that stays away is
//! left out once another is far enough ahead.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`slot`] | a slot's work without clock or bus |
//! | [`words`], [`checkpoint`] | the state of a slot, and how another process goes on from it |
//! | [`join`] | several inputs in the order of ticks |
//! | [`prior`] | what is known of the sensors before the first sample |
//! | [`orders`] | what a service is told at its start, and what follows from it |
//! | [`said`] | what it says on standard error |
//! | [`member`] | a service's place in a running system |
//! | [`reader`] | a topic as a slot reads it |
//! | [`service`] | the loop over the bus |
//! | [`shadow`] | a candidate beside the stage that owns the slot |
//! | [`stage`] | filling a slot with what the launch file names |
//! | [`clock`] | the monotonic clock |
#![forbid(unsafe_code)]

pub mod checkpoint;
pub mod clock;
mod error;
pub mod join;
pub mod member;
pub mod orders;
pub mod prior;
pub mod reader;
pub mod said;
pub mod service;
pub mod shadow;
pub mod slot;
pub mod stage;
pub mod words;

pub use error::RuntimeError;
pub use join::{Beside, Join, Joined};
pub use member::Member;
pub use orders::{Orders, Pace, Role};
pub use prior::{Known, Prior};
pub use reader::{Input, Reader};
pub use service::serve;
pub use slot::{EachTick, Sequence, Slot, Work};

/// Longest interval over which two rates still tell how far the body turned, s. Over a longer one the level is set anew.
pub const BRIDGE_S: f64 = 1.0;
