//! Library for user-defined stages that run as separate programs: frames, programs in Rust, and
//! templates in Rust, Python and C.
//!
//! Input: requests of the service that hosts the stage.
//!
//! Output: one response per request.
//!
//! Failure: an invalid request ends the program.
//!
//! A stage in Rust implements [`attitude::stage::Stage`], a gyro also `GyroStage` and a fuser
//! `FuserStage`. Its `main` function calls `sdk::fuser(MyFuser::default())`.
//!
//! | module | contents |
//! | --- | --- |
//! | [`frame`] | encoding of requests and responses |
//! | `description` | slot and parameters of a stage as text |
//! | `program` | request loop of a stage in Rust |
//! | [`template`] | templates of working stages with tests |
#![forbid(unsafe_code)]

mod description;
pub mod frame;
mod program;
pub mod template;

pub use description::{Description, DescriptionError, ParameterDescription};
pub use program::{accel, course, fuser, gyro};
