//! Every integration test of `link`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod asking;
mod secured;
