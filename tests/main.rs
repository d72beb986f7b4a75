//! System tests on real processes.
//!
//! All tests form one executable, so that they run in parallel and a waiting test leaves its
//! processor to others.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

mod cli;
mod cockpit;
mod docs;
mod network;
mod pipeline;
mod reliability;
