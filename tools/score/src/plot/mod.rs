//! Figures of a run in the style of Matveev 2025: the point w and the angle z over time, the
//! angles, the sphere and the errors.
//!
//! Input: the inputs and outputs of the slots at each tick.
//!
//! Output: SVG files with at most about 2000 points per curve, or fewer so that a file has at most
//! 300 kB.
//!
//! Time: sample timestamps, relative to that of the first sample.
//!
//! Failure: an error if a file cannot be written.
//!
//! | figure | contents |
//! | --- | --- |
//! | `NAME.uvz` | u, v and z of gyro, accelerometer, fused and reference |
//! | `NAME.v` | v of gyro, accelerometer and fused in one panel |
//! | `NAME.angles` | yaw, pitch, roll and course |
//! | `NAME.bias` | gyro bias: estimated, and true if known |
//! | `NAME.error` | inclination error; also heading and total error if the heading is known |
//! | `NAME.signed` | signed roll, pitch, yaw and course errors; yaw drift if north is unknown |
//! | `NAME.bias-error` | gyro bias error, if the true bias is known |
//! | `NAME.sphere` | the up vector on the Riemann sphere, and the plane of w |
//! | `sweep.SETTING` | error over the range of a setting |

pub(crate) mod curve;
mod options;
pub(crate) mod panel;
mod record;
mod sphere;

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use figures::{
    Chart, Draw, Stack,
    style::{AMBER, LineStyle, REFERENCE, SKY, series_style},
};
use launch::Launch;
use plotters::style::RGBColor;

use crate::{ScoreError, table::Sweep};
pub use options::PlotOptions;
use panel::{Series, sweep_chart, time_chart};
pub(crate) use record::PlotRecord;
use record::{Curves, Quantity, Source};
use sphere::Sphere;

/// Width of a figure over time, pixels.
const WIDTH: u32 = 1200;
/// Height of each panel in a figure with several panels, pixels.
const PANEL_HEIGHT: u32 = 300;
/// Height of the panel in a figure with a single panel, pixels.
const SINGLE_PANEL_HEIGHT: u32 = 500;
/// Maximum size of a figure over time in bytes. The limit keeps a browser or a page with many
/// figures fast.
const MAX_FIGURE_BYTES: usize = 300_000;
/// Largest number of bins that are merged to reach [`MAX_FIGURE_BYTES`].
///
/// Merged bins are then about 10 pixels wide, and wider bins would hide details. Figures of many
/// stages can exceed the size limit.
const MAX_MERGED_BINS: usize = 8;
const SPHERE_SIZE: (u32, u32) = (900, 900);

/// A figure over time. Each panel is given by the label of its vertical axis and its quantity.
struct Figure {
    name: &'static str,
    title: &'static str,
    sources: &'static [Source],
    panels: &'static [(&'static str, Quantity)],
}

const FIGURES: [Figure; 7] = [
    Figure {
        name: "uvz",
        title: "w = u + jv and z",
        sources: &Source::ALL,
        panels: &[("u", Quantity::U), ("v", Quantity::V), ("z, °", Quantity::Z)],
    },
    Figure {
        name: "v",
        title: "v of gyro, accelerometer and fused",
        sources: &[Source::Accel, Source::Gyro, Source::Fused],
        panels: &[("v", Quantity::V)],
    },
    Figure {
        name: "angles",
        title: "yaw, pitch, roll and course",
        sources: &Source::ALL,
        panels: &[
            ("yaw ψ, °", Quantity::Yaw),
            ("pitch ϑ, °", Quantity::Pitch),
            ("roll γ, °", Quantity::Roll),
            ("course H, °", Quantity::Course),
        ],
    },
    Figure {
        name: "bias",
        title: "bias of the gyro",
        sources: &Source::ALL,
        panels: &[("ξ, °/s", Quantity::BiasX), ("η, °/s", Quantity::BiasY), ("ζ, °/s", Quantity::BiasZ)],
    },
    Figure {
        name: "error",
        title: "error against the reference",
        sources: &Source::ALL,
        panels: &[
            ("inclination, °", Quantity::InclinationError),
            ("heading, °", Quantity::HeadingError),
            ("total, °", Quantity::TotalError),
        ],
    },
    Figure {
        name: "signed",
        title: "signed error of each angle; for an arbitrary yaw its drift",
        sources: &Source::ALL,
        panels: &[
            ("roll γ, °", Quantity::RollError),
            ("pitch ϑ, °", Quantity::PitchError),
            ("yaw ψ, °", Quantity::YawError),
            ("course H, °", Quantity::CourseError),
        ],
    },
    Figure {
        name: "bias-error",
        title: "error of the gyro's bias",
        sources: &Source::ALL,
        panels: &[("ξ, °/s", Quantity::BiasXError), ("η, °/s", Quantity::BiasYError), ("ζ, °/s", Quantity::BiasZError)],
    },
];

/// Curves of one source, with their name and line style.
type SourceSeries<'a> = (&'a str, (RGBColor, LineStyle), &'a Curves);

/// Draws the figures and writes them to files.
pub(crate) struct Plotter<'a> {
    plots: &'a PlotOptions,
}

impl<'a> Plotter<'a> {
    pub(crate) fn new(plots: &'a PlotOptions) -> Self {
        Self { plots }
    }

    /// Draws one chain's results for a trial, next to those from gyro and accelerometer alone.
    ///
    /// `label` names the chain. File names start with `base_path`.
    pub(crate) fn draw_chain(
        &self,
        base_path: &Path,
        trial: &str,
        label: &str,
        record: &PlotRecord,
    ) -> Result<(), ScoreError> {
        let title = format!("{trial}, {label}");
        for figure in &FIGURES {
            let series = figure.sources.iter().map(|source| {
                let style = match source {
                    Source::Accel => (SKY, LineStyle::Thin),
                    Source::Gyro => (AMBER, LineStyle::Dashed(12, 4)),
                    Source::Fused => series_style(0),
                    Source::Reference => REFERENCE,
                };
                (source.name(), style, record.source_curves(*source))
            });
            self.draw_figure(base_path, &title, figure, &series.collect::<Vec<_>>())?;
        }
        let sphere = Sphere { title: format!("{title}: the up vector"), ups: &record.up_path };
        write(base_path, "sphere", self.render(SPHERE_SIZE, &sphere))
    }

    /// Draws the results of several chains for a trial, and the reference, in the same figures.
    /// `names` contains the names of the chains.
    pub(crate) fn draw_comparison(
        &self,
        base_path: &Path,
        trial: &str,
        names: &[String],
        records: &[&PlotRecord],
    ) -> Result<(), ScoreError> {
        let fused = names
            .iter()
            .zip(records)
            .enumerate()
            .map(|(at, (name, record))| (name.as_str(), series_style(at), record.source_curves(Source::Fused)));
        let reference = records
            .first()
            .map(|record| (Source::Reference.name(), REFERENCE, record.source_curves(Source::Reference)));
        let series: Vec<_> = fused.chain(reference).collect();
        let compared = FIGURES.iter().filter(|figure| figure.sources.contains(&Source::Reference));
        compared.into_iter().try_for_each(|figure| self.draw_figure(base_path, trial, figure, &series))
    }

    /// Draws the error over the range of each evaluated setting.
    pub(crate) fn draw_sweeps(&self, sweeps: &[Sweep]) -> Result<(), ScoreError> {
        for same_setting in sweeps.chunk_by(|a, b| a.setting == b.setting) {
            let styled: Vec<_> = same_setting.iter().enumerate().map(|(at, sweep)| (sweep, series_style(at))).collect();
            let (Some(first), Some(chart)) = (same_setting.first(), sweep_chart(&styled)) else { continue };
            let title = format!("{}: mean error of the trials", first.setting);
            let stack = Stack { title, charts: vec![Chart { has_legend: true, ..chart }] };
            let name = format!("{}.{}", SWEEP_PREFIX, first.setting);
            write(&self.plots.folder.join(&name), "", self.render((WIDTH, SINGLE_PANEL_HEIGHT), &stack))?;
        }
        Ok(())
    }

    fn draw_figure(
        &self,
        base_path: &Path,
        title: &str,
        figure: &Figure,
        sources: &[SourceSeries<'_>],
    ) -> Result<(), ScoreError> {
        let height = |charts: usize| if charts == 1 { SINGLE_PANEL_HEIGHT } else { PANEL_HEIGHT * charts as u32 };
        let mut merged_bins = 1;
        loop {
            let to_chart = |(label, quantity): &(&'static str, Quantity)| {
                let series = sources.iter().map(|(name, style, curves)| Series {
                    name,
                    style: *style,
                    curve: curves.curve(*quantity),
                });
                let series: Vec<_> = series.filter(|series| !series.curve.is_empty()).collect();
                panel_chart(label, self.plots.from_s, &series, merged_bins)
            };
            let charts: Vec<_> = figure.panels.iter().filter_map(to_chart).collect();
            if charts.is_empty() {
                return Ok(());
            }
            let size = (WIDTH, height(charts.len()));
            let svg = self.render(size, &Stack { title: format!("{title}: {}", figure.title), charts });
            let is_too_large = svg.as_ref().is_ok_and(|svg| svg.len() > MAX_FIGURE_BYTES);
            if !is_too_large || merged_bins >= MAX_MERGED_BINS {
                return write(base_path, figure.name, svg);
            }
            merged_bins += 1;
        }
    }

    /// Renders a drawing in the requested size, or in `default_size`.
    fn render(&self, default_size: (u32, u32), drawing: &impl Draw) -> io::Result<String> {
        let size = self.plots.size.unwrap_or(default_size);
        figures::svg(size, drawing).map_err(|cause| io::Error::other(cause.to_string()))
    }
}

/// Writes `BASE_PATH.NAME.svg`.
fn write(base_path: &Path, name: &str, svg: io::Result<String>) -> Result<(), ScoreError> {
    let mut path = base_path.to_path_buf().into_os_string();
    path.push(if name.is_empty() { ".svg".into() } else { format!(".{name}.svg") });
    let path = PathBuf::from(path);
    svg.and_then(|svg| fs::write(&path, svg)).map_err(|cause| ScoreError::Write { path, cause })
}

/// Prefix of the file name of a sweep.
const SWEEP_PREFIX: &str = "sweep";

/// Returns the names of the stages of a chain, in data flow order.
pub(crate) fn chain_label(launch: &Launch) -> String {
    let Launch { gyro, accel, fuser, course, .. } = launch;
    format!("{} + {} → {} → {}", gyro.stage, accel.stage, fuser.stage, course.stage)
}

/// Returns a chart of the curves over time with some margin; `None` if there are no curves.
/// `merged_bins` has the same meaning as in [`time_chart`].
fn panel_chart(label: &'static str, from_s: f64, series: &[Series<'_>], merged_bins: usize) -> Option<Chart> {
    let ranges = || series.iter().filter_map(|series| series.curve.range());
    let min = ranges().map(|range| range.0).reduce(f64::min)?;
    let max = ranges().map(|range| range.1).reduce(f64::max)?;
    let margin = (0.05 * (max - min)).max(1e-3);
    let end_s = series.iter().map(|series| series.curve.end_s()).fold(from_s + 1e-3, f64::max);
    let chart = time_chart(label, from_s..end_s, min - margin..max + margin, series, merged_bins);
    Some(Chart { has_legend: series.len() > 1, ..chart })
}
