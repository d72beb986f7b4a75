//! What a stage of one's own needs: the frames that it is asked by, and a working one to begin with, in Rust, Python and C.
//!
//! Input: requests of the service that hosts the stage. Output: its answers. Time: none. Failure: what is no request ends the program.
//!
//! A stage in Rust implements [`attitude::stage::Stage`] (a gyro also `GyroStage`, a fuser `FuserStage`); its `main` is
//! `sdk::fuser(MyFuser::default())`.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`frame`] | a request or an answer as bytes |
//! | `description` | what a stage says of itself |
//! | `program` | answering, in Rust |
//! | [`template`] | a working stage with a test, to be changed |
#![forbid(unsafe_code)]

mod description;
pub mod frame;
mod program;
pub mod template;

pub use description::{Described, Description, DescriptionError};
pub use program::{accel, course, fuser, gyro};
