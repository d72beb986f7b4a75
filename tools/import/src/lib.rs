//! Import of recordings made by other systems.
//!
//! Input: a PX4 ULog, an ArduPilot log, a MAVLink telemetry log, an MCAP file, a ROS 2 bag, or CSV
//! files with a [`Mapping`] of their columns.
//!
//! Output: a recording that [`recording::Reader`] reads, a file of GNSS fixes next to it, and a
//! [`Summary`] with notes on skipped or missing data. Axes: body right, forward, up; earth east,
//! north, up.
//!
//! Time: the clock of the source, ns.
//!
//! Failure: an unreadable file is rejected with the position of the error. If a log is truncated or
//! damaged, its readable part is imported and the summary reports the damage.
//!
//! | module | content |
//! | --- | --- |
//! | [`mod@convert`] | conversion of files into a recording |
//! | `options` | options of an import |
//! | [`format`](mod@format), `detection` | formats, and their detection by content |
//! | [`summary`] | result of an import |
//! | [`readable`] | recordings of any format as readable files |
//! | [`mcap_file`] | conversion of a recording into an MCAP file |
//! | [`ros_messages`] | decoding of single ROS 2 messages |
//! | `source` | interface of all source formats |
//! | `ulog` | topics of a ULog |
//! | `dataflash` | messages of an ArduPilot log |
//! | `bag` | topics of MCAP files and ROS 2 bags |
//! | `csv_source` | mapped columns of CSV files, joined by time |
//! | `csv_reader` | reader for one CSV file |
//! | `table` | tables of fixes or references in any text dialect |
//! | `tlog` | MAVLink messages of a telemetry log |
//! | `timeline` | wraps and restarts of a clock |
//! | `force_aligner` | force interpolated at the times of the rate samples |
//! | `row_writer` | magnetic field and reference merged into the rows |
#![forbid(unsafe_code)]

mod bag;
pub mod convert;
mod csv_reader;
mod csv_source;
mod dataflash;
mod detection;
mod error;
mod force_aligner;
pub mod format;
pub mod mcap_file;
mod options;
pub mod readable;
pub mod ros_messages;
mod row_writer;
mod sensor_state;
mod source;
pub mod summary;
mod table;
mod timeline;
mod tlog;
mod ulog;

pub use convert::{PlainRecording, Progress, convert, fixes_notes};
pub use error::ImportError;
pub use format::Format;
pub use mapping::{Mapping, MappingError};
pub use options::Options;
pub use summary::{Note, Sensor, Summary};
pub use table::{Table, convert_table};
pub use timeline::Segment;
