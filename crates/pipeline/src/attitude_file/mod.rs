//! The attitude file, `--out` of `plumb up`, `plumb replay` and `plumb score`.
//!
//! | module | contents |
//! | --- | --- |
//! | `columns` | choice of the columns |
//! | `lines` | lines, each joined from an attitude and a fused state |
//! | `csv_writer` | writer thread of the file |

mod columns;
mod csv_writer;
mod lines;

pub use columns::{AttitudeFile, Column};
pub use csv_writer::{STANDARD_OUTPUT, is_same_file};
pub(crate) use lines::AttitudeLines;
