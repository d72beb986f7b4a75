//! External stages: programs that run as a stage in a separate process.
//!
//! Input: the program that a launch file names.
//!
//! Output: a value that implements `attitude::stage::Stage`.
//!
//! Time: a request blocks until its response arrives, up to a timeout.
//!
//! Failure: a program that exits, does not respond in time or sends an invalid response has failed
//! permanently, with a reason. Its outputs are NaN from then on, and the slot does not publish
//! them.
//!
//! | module | contents |
//! | --- | --- |
//! | [`child`] | the process: requests and responses |
//! | [`hosted`] | the external stage |
//! | [`finite_input`] | conversion of inputs to finite numbers |
//! | [`slot_stage`] | a built-in or an external stage |
//! | `interned` | names and parameters of programs with static lifetime |
#![forbid(unsafe_code)]

pub mod child;
pub mod finite_input;
pub mod hosted;
mod interned;
pub mod slot_stage;

pub use child::HostError;
pub use finite_input::FiniteInput;
pub use hosted::{HostableStage, HostedStage};
pub use slot_stage::AnyStage;
