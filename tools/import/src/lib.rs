//! Import: recordings of other systems, made into ours.
//!
//! Input: a ULog of PX4, a log of ArduPilot, an MCAP file, a bag of ROS 2, or CSV files and a [`Mapping`] that says which column is what. Output: a recording as
//! [`recording::Reader`] takes it, the fixes of a satellite receiver beside it, and a [`Summary`] of what was there and what was not.
//! Frames: body right, forward, up; earth east, north, up. Time: the source's own, in ns. Failure: what cannot be read is refused
//! with its place; of a log that is cut or damaged, what was good before is read, and the summary says so.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`mod@convert`] | files in, a recording out |
//! | [`format`](mod@format) | what a file is, by its content |
//! | [`summary`] | what came of it |
//! | `source` | what every kind of log gives |
//! | `ulog` | the topics of a ULog |
//! | `dataflash` | the messages of a log of ArduPilot |
//! | `bag` | the topics of MCAP files and bags of ROS 2 |
//! | `mapped` | the columns of CSV files, joined by time |
//! | `text` | one CSV file of whatever kind |
//! | `aligned` | force at the times of the rate |
//! | [`mcap_file`] | a recording of ours as an MCAP file |
//! | `rows` | field and reference at the times of the rows |
#![forbid(unsafe_code)]

mod force_aligner;
mod bag;
pub mod convert;
mod dataflash;
mod error;
pub mod format;
mod csv_source;
pub mod mcap_file;
pub mod ros_messages;
mod row_writer;
mod source;
pub mod summary;
mod csv_reader;
mod ulog;

pub use convert::{Options, Progress, convert};
pub use error::ImportError;
pub use format::Format;
pub use mapping::{Mapping, MappingError};
pub use summary::{Note, Summary};
