//! Computes attitudes from samples in one process, without the bus, and evaluates and writes them.
//!
//! Input: checked samples.
//!
//! Output: attitudes, their accuracy, latency and order, and a CSV file.
//!
//! Time: the timestamps of the messages.
//!
//! Failure: a failed stage ends the run. A file that can no longer be written ends with a complete
//! line, and the run continues without it.
//!
//! | module | contents |
//! | --- | --- |
//! | [`path`] | the slots of the data path in sequence |
//! | [`schedule`] | stages of each slot and their ticks, as recorded in a flight |
//! | `slot_runner` | a slot with its stages in sequence |
//! | [`collector`] | accuracy, latency and order of the attitudes |
//! | [`attitude_file`] | CSV file of the attitudes, or standard output, `--out` |
#![forbid(unsafe_code)]

pub mod attitude_file;
pub mod collector;
mod error;
pub mod path;
pub mod schedule;
mod slot_runner;

pub use attitude_file::{AttitudeFile, Column, STANDARD_OUTPUT, is_same_file};
pub use collector::{Collector, compared_attitude};
pub use error::CollectorError;
pub use path::Path;
pub use schedule::{ReplayWarning, Schedule};
