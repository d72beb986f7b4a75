//! Tables as pictures, as HTML and as text.

use std::fmt::{self, Display};

use figures::{Area, Draw, DrawResult, style::TEXT};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

const ROW_HEIGHT: u32 = 26;
const MARGIN: u32 = 12;
/// Average width of a character, pixels.
const CHARACTER_WIDTH: f64 = 8.2;
/// Width of the gap between columns, pixels.
const COLUMN_GAP: u32 = 22;

/// Table with a header row. The first column is left-aligned, and all others are right-aligned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Column titles.
    pub header: Vec<String>,
    /// Rows, each with one cell per column.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    pub(crate) fn new(header: &[&str], rows: Vec<Vec<String>>) -> Self {
        Self { header: header.iter().map(|cell| (*cell).into()).collect(), rows }
    }

    /// Returns the length of the longest cell of each column, in characters.
    fn column_widths(&self) -> Vec<usize> {
        let lines = || [&self.header].into_iter().chain(&self.rows);
        (0..self.header.len())
            .map(|column| {
                lines().filter_map(|line| line.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
            })
            .collect()
    }

    fn column_pixels(&self) -> Vec<u32> {
        self.column_widths()
            .into_iter()
            .map(|characters| (characters as f64 * CHARACTER_WIDTH) as u32 + COLUMN_GAP)
            .collect()
    }

    pub(crate) fn size(&self) -> (u32, u32) {
        (self.column_pixels().iter().sum::<u32>() + 2 * MARGIN, (self.rows.len() as u32 + 1) * ROW_HEIGHT + 2 * MARGIN)
    }

    pub(crate) fn to_html(&self) -> String {
        let cells = |cells: &[String], tag: &str| {
            cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape_html(cell))).collect::<String>()
        };
        let rows: String = self.rows.iter().map(|row| format!("<tr>{}</tr>\n", cells(row, "td"))).collect();
        format!("<table><tr>{}</tr>\n{rows}</table>\n", cells(&self.header, "th"))
    }
}

impl Draw for Table {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let (column_pixels, margin) = (self.column_pixels(), MARGIN as i32);
        let right = area.dim_in_pixel().0 as i32 - margin;
        let text = |h: HPos| TEXT.into_font().color(&BLACK).pos(Pos::new(h, VPos::Center));
        for (line, cells) in [&self.header].into_iter().chain(&self.rows).enumerate() {
            let top = margin + line as i32 * ROW_HEIGHT as i32;
            let mut left = margin;
            for (column, (cell, width)) in cells.iter().zip(&column_pixels).enumerate() {
                let middle = top + ROW_HEIGHT as i32 / 2;
                let end = left + *width as i32;
                let gap = COLUMN_GAP as i32 / 2;
                let (x, h) = if column == 0 { (left + gap / 2, HPos::Left) } else { (end - gap, HPos::Right) };
                area.draw(&Text::new(cell.as_str(), (x, middle), text(h)))?;
                left = end;
            }
            let bottom = top + ROW_HEIGHT as i32;
            let rule = if line == 0 { BLACK.mix(0.8) } else { BLACK.mix(0.2) };
            area.draw(&PathElement::new(vec![(margin, bottom), (right, bottom)], rule))?;
        }
        Ok(())
    }
}

impl Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let column_widths = self.column_widths();
        for (line, cells) in [&self.header].into_iter().chain(&self.rows).enumerate() {
            let mut text = String::new();
            for (column, (cell, width)) in cells.iter().zip(&column_widths).enumerate() {
                let (width, gap) = (*width, if column == 0 { "" } else { "  " });
                let cell = if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
                text += &format!("{gap}{cell}");
            }
            if line > 0 {
                writeln!(f)?;
            }
            write!(f, "{}", text.trim_end())?;
        }
        Ok(())
    }
}

/// Escapes text for HTML content and attributes.
pub(crate) fn escape_html(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
