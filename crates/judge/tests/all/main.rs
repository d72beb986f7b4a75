//! Diagnoses of recordings, logs, simulations and arbitrary input, unchanged and with artificial
//! errors.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod after_rotations;
mod arbitrary_input;
mod common;
mod logs;
mod recordings;
mod remedies;
