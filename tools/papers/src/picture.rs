//! Figures and tables, and the files they are written to.

use std::{fs, path::Path};

use figures::{Area, Chart, Draw, DrawResult};
use plotters::prelude::*;

use crate::{PaperError, block_diagram::BlockDiagram, heatmap::Heatmap, scene::Scene, table::Table};

/// Panel of a figure.
#[derive(Debug)]
pub(crate) enum Panel {
    Chart(Chart),
    Heatmap(Heatmap),
    Scene(Scene),
    BlockDiagram(BlockDiagram),
}

/// Figure or table.
#[derive(Debug)]
pub enum Picture {
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
        let svg = figures::svg(self.picture.size(), &self.picture)
            .map_err(|cause| PaperError::Draw { picture: self.name, cause })?;
        let path = folder.join(format!("{}.svg", self.name));
        fs::write(&path, &svg).map_err(|cause| PaperError::Write { path, cause })?;
        Ok(svg)
    }
}

impl Picture {
    fn size(&self) -> (u32, u32) {
        match self {
            Self::Figure(figure) => figure.size,
            Self::Table(table) => table.size(),
        }
    }
}

impl Draw for Picture {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        match self {
            Self::Figure(Figure { panels, columns, .. }) => {
                let areas = area.split_evenly((panels.len().div_ceil(*columns), *columns));
                for (area, panel) in areas.iter().zip(panels) {
                    match panel {
                        Panel::Chart(chart) => chart.draw(area)?,
                        Panel::Heatmap(heatmap) => heatmap.draw(area)?,
                        Panel::Scene(scene) => scene.draw(area)?,
                        Panel::BlockDiagram(diagram) => diagram.draw(area)?,
                    }
                }
            }
            Self::Table(table) => table.draw(area)?,
        }
        Ok(())
    }
}
