//! Rendering of drawings to SVG and PNG.

use std::error::Error;

use plotters::{coord::Shift, prelude::*};

use crate::{font::Typeface, png::Pixels};

/// Result of drawing.
pub type DrawResult = Result<(), Box<dyn Error + Send + Sync>>;
/// Area of a canvas.
pub type Area<B> = DrawingArea<B, Shift>;

/// A drawing, independent of the output format.
pub trait Draw {
    /// Draws over the whole area.
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static;
}

/// Draws an SVG of `size`, pixels, and returns its text.
///
/// # Errors
///
/// Returns an error if the drawing or the SVG backend fails.
pub fn svg(size: (u32, u32), drawing: &impl Draw) -> Result<String, Box<dyn Error + Send + Sync>> {
    let mut text = String::new();
    draw_on(&SVGBackend::with_string(&mut text, size).into_drawing_area(), drawing)?;
    Ok(text)
}

/// Draws a PNG of `size`, pixels, and returns its bytes.
///
/// Every length is doubled, so that the picture stays sharp on a high-density screen.
///
/// # Errors
///
/// Returns an error if the drawing, the pixel backend or the compression fails.
pub fn png(
    size: (u32, u32),
    drawing: &impl Draw,
    typeface: &Typeface,
) -> Result<Vec<u8>, Box<dyn Error + Send + Sync>> {
    let mut pixels = Pixels::new(size);
    draw_on(&pixels.canvas(typeface).into_drawing_area(), drawing)?;
    Ok(pixels.encode()?)
}

fn draw_on<B: DrawingBackend>(area: &Area<B>, drawing: &impl Draw) -> DrawResult
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    drawing.draw(area)?;
    area.present()?;
    Ok(())
}
