//! The whole system on real processes: one executable, because what waits in one part leaves the processors to another.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

mod cli;
mod cockpit;
mod network;
mod pipeline;
mod reliability;
