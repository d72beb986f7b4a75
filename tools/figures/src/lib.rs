//! Figures as SVG.
//!
//! Input: a [`Draw`] value and a size in pixels.
//!
//! Output: the text of an SVG file. The text contains no font; the viewer supplies the fonts.
//!
//! | module | contents |
//! | --- | --- |
//! | [`canvas`] | the [`Draw`] trait and its rendering to SVG |
//! | [`chart`] | curves in a pair of axes, and stacked charts |
//! | [`style`] | colours, text sizes, line styles |
#![forbid(unsafe_code)]

pub mod canvas;
pub mod chart;
mod dashes;
pub mod style;

pub use canvas::{Area, Draw, DrawResult, svg};
pub use chart::{Axis, Chart, Curve, Stack};
