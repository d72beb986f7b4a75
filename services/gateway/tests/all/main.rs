//! Integration tests of `gateway`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod idempotent_swaps;
mod split;
