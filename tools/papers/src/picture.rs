//! What can be drawn, and the files it becomes.

use std::{error::Error, fs, path::Path};

use plotters::{coord::Shift, prelude::*};

use crate::{
    PaperError, chart::Chart, font::Typeface, map::Map, png::Pixels, scene::Scene, scheme::Scheme, table::Table,
};

pub(crate) type Drawn = Result<(), Box<dyn Error + Send + Sync>>;
pub(crate) type Area<B> = DrawingArea<B, Shift>;

/// Colours of Okabe and Ito 2008, which people of any colour vision tell apart.
pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(crate) const ORANGE: RGBColor = RGBColor(213, 94, 0);
pub(crate) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(crate) const PURPLE: RGBColor = RGBColor(204, 121, 167);
pub(crate) const SKY: RGBColor = RGBColor(86, 180, 233);
pub(crate) const GREY: RGBColor = RGBColor(90, 90, 90);

/// Sizes of text.
pub(crate) const TITLE: (&str, u32) = ("sans-serif", 18);
pub(crate) const TEXT: (&str, u32) = ("sans-serif", 14);

/// One panel of a figure.
#[derive(Debug)]
pub(crate) enum Panel {
    Chart(Chart),
    Map(Map),
    Scene(Scene),
    Scheme(Scheme),
}

/// A figure or a table.
#[derive(Debug)]
pub enum Picture {
    /// Panels in rows of `columns`.
    Figure(Figure),
    /// A table, drawn and as text.
    Table(Table),
}

/// Panels side by side and one above the other.
#[derive(Debug)]
pub struct Figure {
    pub(crate) size: (u32, u32),
    pub(crate) columns: usize,
    pub(crate) panels: Vec<Panel>,
}

/// A figure or table of a paper, made here.
#[derive(Debug)]
pub struct Part {
    /// Its files' name, as `figure-4`.
    pub name: &'static str,
    /// Its heading, as `Figure 4: u, v and z, noise-free`.
    pub title: String,
    /// What it shows, with the paper's numbers beside ours.
    pub about: String,
    /// What is drawn.
    pub picture: Picture,
}

impl Part {
    /// Writes `NAME.svg` and, with a typeface, `NAME.png` into a folder; the text of the SVG.
    pub(crate) fn write(&self, folder: &Path, typeface: Option<&Typeface>) -> Result<String, PaperError> {
        let failed = |cause| PaperError::Draw { picture: self.name, cause };
        let path = |ending: &str| folder.join(format!("{}.{ending}", self.name));
        let (size, mut svg) = (self.picture.size(), String::new());
        self.picture.draw(&SVGBackend::with_string(&mut svg, size).into_drawing_area()).map_err(failed)?;
        let written = |path: std::path::PathBuf, bytes: &[u8]| {
            fs::write(&path, bytes).map_err(|cause| PaperError::Write { path, cause })
        };
        written(path("svg"), svg.as_bytes())?;
        if let Some(typeface) = typeface {
            let mut pixels = Pixels::new(size);
            self.picture.draw(&pixels.canvas(typeface).into_drawing_area()).map_err(failed)?;
            let bytes = pixels.encoded().map_err(|cause| failed(cause.into()))?;
            written(path("png"), &bytes)?;
        }
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

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        area.fill(&WHITE)?;
        match self {
            Self::Figure(Figure { panels, columns, .. }) => {
                let areas = area.split_evenly((panels.len().div_ceil(*columns), *columns));
                for (area, panel) in areas.iter().zip(panels) {
                    match panel {
                        Panel::Chart(chart) => chart.draw(area)?,
                        Panel::Map(map) => map.draw(area)?,
                        Panel::Scene(scene) => scene.draw(area)?,
                        Panel::Scheme(scheme) => scheme.draw(area)?,
                    }
                }
            }
            Self::Table(table) => table.draw(area)?,
        }
        area.present()?;
        Ok(())
    }
}

/// A number as short as it is: 20, 0.5, not 20.0, −0.0.
pub(crate) fn number(value: &f64) -> String {
    // What is left of a sum of ticks is none.
    let value = if value.abs() < 1e-9 { &0.0 } else { value };
    let text = if *value != 0.0 && value.abs() < 1e-3 { format!("{value:.0e}") } else { format!("{value:.3}") };
    let short = if text.contains('e') { &text } else { text.trim_end_matches('0').trim_end_matches('.') };
    if short == "-0" { "0".into() } else { short.replace('-', "−") }
}
