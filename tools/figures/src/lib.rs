//! Figures as SVG and PNG.
//!
//! Input: a [`Draw`] value and a size in pixels.
//!
//! Output: the bytes of a file.
//!
//! Failure: PNG needs an installed typeface; if none is found, the error names the package to
//! install. SVG needs no typeface, because the viewer supplies it.
//!
//! | module | contents |
//! | --- | --- |
//! | [`canvas`] | the [`Draw`] trait and its rendering to SVG or PNG |
//! | [`chart`] | curves in a pair of axes, and stacked charts |
//! | [`style`] | colours, text sizes, line styles |
//! | [`font`], `png` | an installed typeface; the pixel backend of PNG |
#![forbid(unsafe_code)]

pub mod canvas;
pub mod chart;
mod dashes;
pub mod font;
mod png;
pub mod style;

pub use canvas::{Area, Draw, DrawResult, png, svg};
pub use chart::{Axis, Chart, Curve, Stack};
pub use font::Typeface;
