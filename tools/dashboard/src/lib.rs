//! The full-screen views of `plumb top` and `plumb station`.
//!
//! - Input: a [`Snapshot`]: state, attitude, trends and tables of a system, as plain data.
//! - Output: the snapshot on a terminal of any size.
//! - Time: ages and intervals are given by the caller.
//! - Failure: an error if the terminal is closed. The terminal is restored at the end and on a
//!   panic.
//!
//! | module | contents |
//! | --- | --- |
//! | [`snapshot`] | data of one frame |
//! | `orientation` | conversion of an attitude message for display |
//! | [`trend`] | values of the last minute |
//! | `drawing`, `horizon`, `colours` | rendering |
//! | [`screen`] | terminal and keys |
#![forbid(unsafe_code)]

mod colours;
mod drawing;
mod horizon;
mod orientation;
pub mod screen;
pub mod snapshot;
pub mod trend;

pub use orientation::Attitude;
pub use screen::{Key, Screen};
pub use snapshot::{DataState, Panel, Row, RowStyle, Snapshot};
pub use trend::{Figures, Trend, Trends};
