//! Figures and tables, and the files they are written to.

use std::{error::Error, fs, path::Path};

use figures::{Area, Chart, Draw, DrawResult};
use plotters::prelude::*;

use crate::{PaperError, heatmap::Heatmap, sphere::Sphere, table::Table};

/// Panel of a figure.
#[derive(Debug)]
pub(crate) enum Panel {
    Chart(Chart),
    Heatmap(Heatmap),
    Sphere(Sphere),
}

/// Figure or table.
#[derive(Debug)]
pub enum Picture {
    /// Figure without computed data: the text of its SVG file.
    Drawing(&'static str),
    /// Figure with one or more panels.
    Figure(Figure),
    /// Table, which is both drawn and available as text.
    Table(Table),
}

/// Panels in a grid, filled row by row.
#[derive(Debug)]
pub struct Figure {
    pub(crate) size: (u32, u32),
    pub(crate) columns: usize,
    pub(crate) panels: Vec<Panel>,
}

/// Reproduced figure or table of a paper.
#[derive(Debug)]
pub struct Part {
    /// File name without extension, such as `figure-4`.
    pub name: &'static str,
    /// Heading, such as `Figure 4: u, v and z, noise-free`.
    pub title: String,
    /// Description that compares the numbers of the paper with the reproduced ones.
    pub caption: String,
    /// The figure or table.
    pub picture: Picture,
}

impl Part {
    /// Writes `NAME.svg` to a folder. Returns the SVG text.
    pub(crate) fn write(&self, folder: &Path) -> Result<String, PaperError> {
        let svg = self.picture.to_svg().map_err(|cause| PaperError::Draw { picture: self.name, cause })?;
        let path = folder.join(format!("{}.svg", self.name));
        fs::write(&path, &svg).map_err(|cause| PaperError::Write { path, cause })?;
        Ok(svg)
    }
}

/// Defines a function for each drawing of a paper: its name, title and caption.
///
/// The SVG file is `drawings/PAPER/NAME.svg`.
macro_rules! drawings {
    ($paper:literal: $($function:ident = $name:literal, $title:literal, $caption:literal;)+) => {
        $(pub(super) fn $function() -> $crate::picture::Part {
            let svg = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/drawings/", $paper, "/", $name, ".svg"));
            let picture = $crate::picture::Picture::Drawing(svg);
            $crate::picture::Part { name: $name, title: $title.into(), caption: $caption.into(), picture }
        })+
    };
}
pub(crate) use drawings;

impl Picture {
    /// Returns the text of the SVG file.
    fn to_svg(&self) -> Result<String, Box<dyn Error + Send + Sync>> {
        match self {
            Self::Drawing(svg) => Ok((*svg).into()),
            Self::Figure(figure) => figures::svg(figure.size, figure),
            Self::Table(table) => figures::svg(table.size(), table),
        }
    }
}

impl Draw for Figure {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let areas = area.split_evenly((self.panels.len().div_ceil(self.columns), self.columns));
        for (area, panel) in areas.iter().zip(&self.panels) {
            match panel {
                Panel::Chart(chart) => chart.draw(area)?,
                Panel::Heatmap(heatmap) => heatmap.draw(area)?,
                Panel::Sphere(sphere) => sphere.draw(area)?,
            }
        }
        Ok(())
    }
}
