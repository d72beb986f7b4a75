//! Flights: MCAP recordings of a running system.
//!
//! Input: messages of the topics as bytes, from whoever reads them. Output: a file that other tools open: each topic on a channel of its name
//! as protobuf with its schema, the attitude as viewers know it beside it, and what ran. Time: [`Stamps`] says which clock is which.
//! Failure: nobody waits for the disk; what a full queue or a full disk costs is counted and told, and the file ends with a whole
//! chunk. A process that is killed leaves a file that lacks its summary and half a second at most.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`recorder`] | what a reader hands messages to, and the thread that writes |
//! | `writer` | the MCAP file: channels, messages, metadata, attachments |
//! | `chunk_file` | a file that grows by whole chunks |
//! | `gaps` | which ticks never came |
//! | [`summary`] | what came of it |
//! | [`reader`] | the messages of a flight, to fly it again |
//! | [`info`] | what a flight holds |
#![forbid(unsafe_code)]

mod chunk_file;
mod error;
mod gaps;
pub mod info;
#[cfg(test)]
mod layouts;
pub mod reader;
pub mod recorder;
pub mod summary;
#[cfg(test)]
mod tests;
mod writer;

pub use error::FlightError;
pub use info::FlightInfo;
pub use reader::{is_flight, launch_file, messages_of};
pub use recorder::{Heading, Mode, Recorder, free_path};
pub use summary::Summary;
pub use wire::channel::Stamps;
