//! Calibrations compared with truth: simulated units, and recordings with added errors.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod broad;
mod launch_file;
mod noise;
mod rejections;
mod simulated;
mod truth;
mod unit;
