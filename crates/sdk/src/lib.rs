//! Library for user-defined stages that run as separate programs: frames, programs in Rust, and
//! templates in Rust, Python and C.
//!
//! Input: requests from the service that hosts the stage.
//!
//! Output: one response per request.
//!
//! Failure: an invalid request ends the program.
//!
//! A stage in Rust implements [`attitude::stage::Stage`]. A gyro stage also implements `GyroStage`,
//! and a fuser stage also implements `FuserStage`. The `main` function of a fuser stage calls
//! `sdk::fuser(MyFuser::default())`.
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
