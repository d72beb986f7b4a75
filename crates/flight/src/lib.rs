//! Flights: MCAP recordings of a running system.
//!
//! Input: topic messages, as raw bytes from the bus.
//!
//! Output: an MCAP file that other tools can open. It has a channel per topic (protobuf with its
//! schema), channels for viewers, and the configuration of the run.
//!
//! Time: see [`Stamps`] for the clocks of the timestamps.
//!
//! Failure: the disk never blocks a live system. Messages lost because the queue or the disk is
//! full are counted and reported, and the file ends with a complete chunk. If the process is
//! killed, the file lacks its summary and up to half a second of messages.
//!
//! | module | content |
//! | --- | --- |
//! | [`recorder`] | recorder with its writer thread |
//! | `writer` | content of a flight: channels, messages, metadata, attachments |
//! | `mcap_file` | MCAP file whose index is not kept in memory |
//! | `spill_file` | records of the index until the end |
//! | `chunk_file` | file that grows in complete chunks |
//! | `gaps` | count of missed ticks |
//! | [`summary`] | summary of a recorded file |
//! | [`reader`] | messages of a flight, for replay |
//! | [`info`] | content of a flight |
#![forbid(unsafe_code)]

mod chunk_file;
mod error;
mod gaps;
mod header;
pub mod info;
#[cfg(test)]
mod layouts;
mod mcap_file;
pub mod reader;
pub mod recorder;
mod spill_file;
pub mod summary;
#[cfg(test)]
mod tests;
mod writer;

pub use error::FlightError;
pub use header::FlightHeader;
pub use info::FlightInfo;
pub use reader::{is_flight, read_launch_file, read_messages};
pub use recorder::{Recorder, RecordingMode, unused_path};
pub use summary::RecordingSummary;
pub use wire::channel::Stamps;
