//! The command line as people use it.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../common/mod.rs"]
mod common;

mod calibrate;
mod keys;
mod means;
mod output;
mod seeing;
mod up;
mod warnings;
