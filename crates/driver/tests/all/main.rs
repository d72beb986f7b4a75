//! The clock fit against simulated devices, and feeds of a bus.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod clock_fit;
mod feeds;
