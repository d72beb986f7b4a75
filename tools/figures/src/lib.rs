//! Figures as SVG and as PNG.
//!
//! Input: what is to be drawn, and how large. Output: the bytes of a file. Time: none. Failure: a PNG needs a typeface of the system; where there is none, what to
//! install is said. An SVG needs none, its viewer brings the typeface.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`canvas`] | what can be drawn, and the bytes it becomes |
//! | [`chart`] | curves over an axis, charts one above the other |
//! | [`style`] | colours, sizes of text, how lines differ |
//! | [`font`], `png` | a typeface of the system; a picture of pixels |
#![forbid(unsafe_code)]

pub mod canvas;
pub mod chart;
mod dashes;
pub mod font;
mod png;
pub mod style;

pub use canvas::{Area, Draw, Drawn, png, svg};
pub use chart::{Axis, Chart, Curve, Stack};
pub use font::Typeface;
