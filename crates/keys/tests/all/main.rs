//! Every integration test of `keys`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod access;
mod both_ways;
mod carrying;
mod common;
mod connections;
mod direct;
mod folder;
