//! Text of numbers, and which of its columns is what: the words that people use for it, wherever such text comes from.
//!
//! Input: pairs such as `gx=gyro_x`, units such as `deg/s,g`, axes such as `frd`; fields of a line. Output: a [`Mapping`] that turns
//! numbers of a line into SI units and body axes right, forward, up. Time: as the text has it. Failure: a [`MappingError`] with what
//! was found and what was expected.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `mapping` | which column is what, and its unit and frame |
//! | `rotation` | what is a rotation |
//! | [`text`] | fields of a line, times as text |
//! | [`names`] | names that are nearly others |
#![forbid(unsafe_code)]

mod mapping;
pub mod names;
mod rotation;
pub mod text;

pub use mapping::{FIELD, FORCE, Mapping, MappingError, POSITION, RATE, REFERENCE};
pub use rotation::is_rotation;
