//! Tests of the crate against the data path of the system.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod builder;
mod digest;
mod faults;
mod golden;
mod parts;
mod path;
mod recordings;
mod snapshot;
mod updates;
