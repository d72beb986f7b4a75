//! Calibrations against truth: simulated units, and real recordings with errors added.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod broad;
mod launch_file;
mod refusals;
mod simulated;
mod truth;
mod unit;
