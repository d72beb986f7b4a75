//! Every integration test of `gateway`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod carrying;
mod idempotent_swaps;
