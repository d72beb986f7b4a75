//! Integration tests of `conformance` in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod all_stages;
mod bad_stages;
mod chain;
mod golden;
