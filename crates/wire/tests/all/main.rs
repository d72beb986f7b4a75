//! Integration tests of `wire`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;
mod generated;
mod round_trip;
mod schema;
mod untrusted;
