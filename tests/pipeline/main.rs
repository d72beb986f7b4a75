//! The data path on real processes: recordings, bad input, determinism, conventions, scores.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../common/mod.rs"]
mod common;

mod bad_input;
mod conventions;
mod determinism;
mod drivers;
mod fault_script;
mod import;
mod orchestrated;
mod output;
mod replay;
mod score;
mod sources;
mod warm_start;
