//! What can be drawn, and the bytes it becomes.

use std::error::Error;

use plotters::{coord::Shift, prelude::*};

use crate::{font::Typeface, png::Pixels};

/// How a drawing went.
pub type Drawn = Result<(), Box<dyn Error + Send + Sync>>;
/// Where something is drawn.
pub type Area<B> = DrawingArea<B, Shift>;

/// What can be drawn, in vectors as in pixels.
pub trait Draw {
    /// Draws it over the whole area.
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static;
}

/// The text of an SVG of this size, pixels.
pub fn svg(size: (u32, u32), of: &impl Draw) -> Result<String, Box<dyn Error + Send + Sync>> {
    let mut text = String::new();
    drawn(&SVGBackend::with_string(&mut text, size).into_drawing_area(), of)?;
    Ok(text)
}

/// The bytes of a PNG of this size, pixels; every length is doubled, so that it stays sharp.
pub fn png(size: (u32, u32), of: &impl Draw, typeface: &Typeface) -> Result<Vec<u8>, Box<dyn Error + Send + Sync>> {
    let mut pixels = Pixels::new(size);
    drawn(&pixels.canvas(typeface).into_drawing_area(), of)?;
    Ok(pixels.encoded()?)
}

fn drawn<B: DrawingBackend>(area: &Area<B>, of: &impl Draw) -> Drawn
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    of.draw(area)?;
    area.present()?;
    Ok(())
}
