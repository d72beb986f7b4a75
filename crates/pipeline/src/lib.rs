//! From a sample to an attitude in one process, without the bus, and what becomes of the attitudes.
//!
//! Input: checked samples. Output: attitudes; their accuracy, latency and order; the file. Time: none but the stamps of the messages.
//! Failure: a stage that cannot go on ends the path; a file that cannot be written ends with a whole line and nothing else does.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`path`] | the slots of the path, one after the other |
//! | [`schedule`] | which stage has which slot from which tick on, of a flight |
//! | `seat` | a slot with the stages that it has one after the other |
//! | [`columns`] | what a line of the file of attitudes has |
//! | `lines` | its lines, each of an attitude and a fused state |
//! | [`collector`] | what becomes of the attitude: accuracy, latency, order |
//! | `out` | the file of attitudes |
#![forbid(unsafe_code)]

pub mod collector;
pub mod columns;
mod lines;
mod out;
pub mod path;
pub mod schedule;
mod seat;

pub use collector::{Collector, CollectorError};
pub use columns::{Column, OutFile};
pub use out::is_same_file;
pub use path::Path;
pub use schedule::{Doubt, Schedule};
