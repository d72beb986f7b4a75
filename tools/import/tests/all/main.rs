//! Recordings of others: made here, real ones, broken ones, and what their own reader says of them.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod ardupilot;
mod bags;
mod common;
mod damage;
mod flights;
mod foreign;
mod formats;
mod logs;
mod mistakes;
mod mutated;
mod pipeline;
#[path = "../../../../tests/common/python.rs"]
mod python;
mod readers;
mod tables;
