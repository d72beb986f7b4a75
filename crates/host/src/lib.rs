//! Stages that are programs of their own, as stages like any other.
//!
//! Input: the program that a launch file names. Output: a value that implements `attitude::stage::Stage`. Time: a request waits for its answer, up
//! to a limit. Failure: a program that dies, says nothing, or answers with what is no answer has failed, with the reason; its outputs are
//! then no numbers, which its slot does not publish.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`child`] | the process: requests and answers |
//! | [`hosted`] | the stage |
//! | [`finite_input`] | what a program is given: finite numbers |
//! | [`slot_stage`] | a stage of Plumbline's own or a hosted one |
//! | `interned` | what a program says of itself, kept as long as this process |
#![forbid(unsafe_code)]

pub mod child;
pub mod finite_input;
pub mod hosted;
mod interned;
pub mod slot_stage;

pub use child::HostError;
pub use finite_input::Given;
pub use hosted::{Hosted, HostedBy};
pub use slot_stage::AnyStage;
