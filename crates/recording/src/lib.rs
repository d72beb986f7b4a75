//! Recordings of an inertial sensor: CSV, plain or gzip.
//!
//! Input: a file with one header line; columns `t_s,gx,gy,gz,ax,ay,az` in s, rad/s, m/s², optionally `mx,my,mz` in
//! µT, `qw,qx,qy,qz` and `mov`, in any order; a receiver's fixes in a file beside it, see [`gnss`].
//! Output: its rows one by one, in constant memory, or a survey of the whole. Time: the recording's own.
//! Failure: the first malformed line ends the reading, with its place, what was found and what was expected.
//! [`References`] are the true attitude from a file of its own. A [`Writer`] makes such a file of rows, and the reader gives the same rows again.
#![forbid(unsafe_code)]

mod columns;
mod error;
pub mod gnss;
mod input;
mod output;
mod reader;
mod reference;
mod survey;
mod table;
mod time;
mod writer;

pub use error::{Fault, Position, RecordingError};
pub use output::unfinished;
pub use reader::{Reader, Reference, Row};
pub use reference::{GAP_NS, References};
pub use survey::{Survey, survey};
pub use writer::{Layout, Writer};
