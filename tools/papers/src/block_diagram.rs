//! Block diagrams.

use figures::{
    Area, DrawResult,
    style::{TEXT, TITLE},
};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::scene::arrow;

/// Blocks and arrows in a plane of `size`, y downwards.
#[derive(Debug)]
pub(crate) struct BlockDiagram {
    pub(crate) title: String,
    pub(crate) size: (f64, f64),
    pub(crate) blocks: Vec<Block>,
    pub(crate) arrows: Vec<Arrow>,
}

/// Box with lines of text, given by its centre and size.
#[derive(Debug)]
pub(crate) struct Block {
    pub(crate) at: (f64, f64),
    pub(crate) size: (f64, f64),
    pub(crate) lines: &'static [&'static str],
}

/// Path with an arrow head, labelled at the middle of its first segment.
#[derive(Debug)]
pub(crate) struct Arrow {
    pub(crate) path: &'static [(f64, f64)],
    pub(crate) label: &'static str,
}

impl BlockDiagram {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, TITLE)?.margin(10, 10, 10, 10);
        let (width, height) = area.dim_in_pixel();
        let (x_unit, y_unit) = (f64::from(width) / self.size.0, f64::from(height) / self.size.1);
        let to_pixel = |(x, y): (f64, f64)| ((x * x_unit).round() as i32, (y * y_unit).round() as i32);
        let text = |h: HPos, v: VPos| TEXT.into_font().color(&BLACK).pos(Pos::new(h, v));
        for Arrow { path, label } in &self.arrows {
            let path: Vec<_> = path.iter().map(|point| to_pixel(*point)).collect();
            arrow(&area, &path, RGBColor(60, 60, 60))?;
            if let [from, to, ..] = path[..] {
                let horizontal = from.1 == to.1;
                let middle = ((from.0 + to.0) / 2, (from.1 + to.1) / 2);
                let (position, style) = if horizontal {
                    ((middle.0, middle.1 - 3), text(HPos::Center, VPos::Bottom))
                } else {
                    ((middle.0 + 6, middle.1), text(HPos::Left, VPos::Center))
                };
                area.draw(&Text::new(*label, position, style))?;
            }
        }
        for Block { at: (x, y), size: (block_width, block_height), lines } in &self.blocks {
            let corners = [
                to_pixel((x - block_width / 2.0, y - block_height / 2.0)),
                to_pixel((x + block_width / 2.0, y + block_height / 2.0)),
            ];
            area.draw(&Rectangle::new(corners, RGBColor(240, 244, 250).filled()))?;
            area.draw(&Rectangle::new(corners, BLACK.mix(0.7).stroke_width(1)))?;
            let (centre_x, centre_y) = to_pixel((*x, *y));
            for (row, line) in lines.iter().enumerate() {
                let y = centre_y + (20.0 * (row as f64 - 0.5 * (lines.len() as f64 - 1.0))) as i32;
                area.draw(&Text::new(*line, (centre_x, y), text(HPos::Center, VPos::Center)))?;
            }
        }
        Ok(())
    }
}
