//! Maps the columns of a text file or stream to quantities, units and axes.
//!
//! Input: pairs such as `gx=gyro_x`, units such as `deg/s,g` and axes such as `frd`, and the fields
//! of a line.
//!
//! Output: a [`Mapping`] that converts the numbers of a line to SI units and to body axes right,
//! forward, up.
//!
//! Time: as given in the text.
//!
//! Failure: a [`MappingError`] with the text found and the values expected.
//!
//! | module | contents |
//! | --- | --- |
//! | `mapping` | columns, units and frame |
//! | `header` | quantities and units in column names |
//! | `units` | units and the targets that they apply to |
//! | `rotation` | check for a unit quaternion |
//! | [`text`] | comments, separators, numbers and times in text |
//! | [`counter`] | wraps of counters |
//! | [`names`] | suggestions for misspelt names |
#![forbid(unsafe_code)]

pub mod counter;
mod header;
mod mapping;
pub mod names;
mod rotation;
pub mod text;
mod units;

pub use header::{HeaderError, names_with_units};
pub use mapping::{Mapping, MappingError, POSITION, REFERENCE, SCORED, Units};
pub use rotation::is_rotation;
pub use units::{FIELD, FORCE, RATE, unit_of_earth_field};
