//! Reads and writes recordings of an inertial sensor: CSV, plain, gzip or zstd.
//!
//! Input: a file with one header line. Columns `t_s,gx,gy,gz,ax,ay,az` in s, rad/s, m/s²,
//! optionally `mx,my,mz` in µT, `qw,qx,qy,qz` and `mov`, in any order.
//!
//! Output: rows one by one in constant memory ([`Reader`]), or a [`Survey`] of the complete file.
//!
//! Time: the recording's own clock.
//!
//! Failure: reading ends at the first malformed line, with its position, the text found and the
//! expected format.
//!
//! Satellite fixes are in a separate file ([`gnss`]). The reference attitude may also be in a
//! separate file ([`References`]). A [`Writer`] writes a recording that [`Reader`] reads back
//! unchanged.
#![forbid(unsafe_code)]

mod atomic_file;
mod columns;
mod error;
pub mod gnss;
mod reader;
mod reference;
mod survey;
mod table;
mod text_lines;
mod time;
mod unpacked;
mod writer;

pub use atomic_file::{temporary_path, write_atomic};
pub use error::{ParseError, Position, RecordingError};
pub use reader::{Reader, Reference, Row};
pub use reference::{MAX_GAP_NS, References, rotated};
pub use survey::{Survey, survey};
pub use text_lines::{MAX_LINE_BYTES, TextLine, TextLines};
pub use unpacked::Unpacked;
pub use writer::{Layout, Writer};
