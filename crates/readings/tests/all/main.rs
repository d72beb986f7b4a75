//! Integration tests of `readings`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod conditioner;
mod fault_injection;
