//! The full-screen views of `plumb top` and `plumb station`.
//!
//! Input: a [`Picture`], plain data: the state of a system in a word, its attitude, its trends and lines of text. Output: the picture on a terminal,
//! drawn in place for whatever size that has. Time: ages and intervals are the caller's. Failure: where the terminal is gone, an error; it is given
//! back as it was found, also by a panic.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`picture`] | what is drawn |
//! | `orientation` | from a message to the attitude that is drawn |
//! | [`trend`] | the last minute of a value |
//! | `drawing`, `horizon` | how it is drawn |
//! | [`screen`] | the terminal and its keys |
#![forbid(unsafe_code)]

mod drawing;
mod horizon;
mod orientation;
pub mod picture;
pub mod screen;
pub mod trend;

pub use picture::{Attitude, Facts, Mark, Panel, Picture, Row, State};
pub use screen::{Key, Screen};
pub use trend::{Trend, Trends};
