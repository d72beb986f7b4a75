//! External stages: programs that run as a stage in a separate process.
//!
//! Input: the program named in a launch file.
//!
//! Output: a value that implements `attitude::stage::Stage`.
//!
//! Time: a request blocks until its response arrives, up to a timeout.
//!
//! Failure: a program that exits, does not respond in time or sends an invalid response has failed
//! permanently, and the reason is recorded. From then on its outputs are NaN, and the slot does not
//! publish them.
//!
//! | module | contents |
//! | --- | --- |
//! | [`child`] | the process: requests and responses |
//! | [`hosted`] | the external stage |
//! | [`finite_input`] | conversion of inputs to finite numbers |
//! | [`slot_stage`] | a built-in or an external stage |
//! | `stage_output` | text that the program prints |
//! | `interned` | names and parameters of programs, interned with static lifetime |
#![forbid(unsafe_code)]

pub mod child;
pub mod finite_input;
pub mod hosted;
mod interned;
pub mod slot_stage;
mod stage_output;

pub use child::HostError;
pub use finite_input::FiniteInput;
pub use hosted::{HostableStage, HostedStage};
pub use slot_stage::AnyStage;
