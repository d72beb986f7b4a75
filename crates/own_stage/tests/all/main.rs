//! Every integration test of `own_stage`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod layouts;
mod rules;
