//! Clock fit on simulated devices, and publishers on a bus.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod clock_fit;
mod feeds;
