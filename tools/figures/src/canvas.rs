//! Rendering of drawings to SVG.

use std::error::Error;

use plotters::{coord::Shift, prelude::*};

/// Result of drawing.
pub type DrawResult = Result<(), Box<dyn Error + Send + Sync>>;
/// Area of a canvas.
pub type Area<B> = DrawingArea<B, Shift>;

/// Drawing that can be rendered on any drawing backend.
pub trait Draw {
    /// Draws over the whole area.
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static;
}

/// Draws an SVG with a `size` in pixels and returns its text.
///
/// # Errors
///
/// Returns an error if the drawing or the SVG backend fails.
pub fn svg(size: (u32, u32), drawing: &impl Draw) -> Result<String, Box<dyn Error + Send + Sync>> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
    area.fill(&WHITE)?;
    drawing.draw(&area)?;
    area.present()?;
    drop(area);
    Ok(text)
}
