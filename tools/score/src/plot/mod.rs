//! Figures of a run, as Matveev 2025 draws them: the point w and the turn z over time, the angles, the sphere, the errors.
//!
//! Input: what goes into the slots at a tick and what comes out. Output: files, SVG or PNG, of some 2000 points a curve, whatever the length of
//! the trial. Time: that of the samples, from the first. Failure: a file that cannot be written; a PNG where the system has no typeface.
//!
//! | figure | what it shows |
//! | --- | --- |
//! | `NAME.uvz` | u, v and z of gyro, accelerometer, fused and reference |
//! | `NAME.v` | v of gyro, accelerometer and fused in one panel |
//! | `NAME.angles` | yaw, pitch, roll and course |
//! | `NAME.bias` | the gyro's bias, estimated, and true where that is known |
//! | `NAME.error` | inclination error where there is a reference, heading and total error where a heading is known |
//! | `NAME.signed` | errors of roll, pitch, yaw and course with their signs; of a yaw that is counted from nowhere how far it has drifted |
//! | `NAME.bias-error` | the error of the gyro's bias, where that is known |
//! | `NAME.sphere` | the up vector on the Riemann sphere, and the plane of w |
//! | `sweep.SETTING` | the error over the range of a setting |

pub(crate) mod curve;
mod record;
mod sphere;

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use figures::{
    Axis, Chart, Draw, Stack, Typeface,
    style::{AMBER, REFERENCE, SKY, Style, of_place},
};
use launch::Launch;

use crate::{ScoreError, tune::Sweep};
use curve::Curve;
pub(crate) use record::Record;
use record::{Curves, Quantity, Source};
use sphere::Sphere;

/// Width of a figure over time, and the height of each of its panels, or of the only one, pixels.
const WIDTH: u32 = 1200;
const HEIGHT: u32 = 300;
const HEIGHT_ALONE: u32 = 500;
const SPHERE: (u32, u32) = (900, 900);
/// A step of a curve in degrees that is only the wrap of an angle.
const WRAP: f64 = 180.0;

/// Which figures are asked for.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plots {
    /// Where they go.
    pub folder: PathBuf,
    /// From when on, seconds from the first sample.
    pub from_s: f64,
    /// Until when; to the end where nothing is said.
    pub to_s: Option<f64>,
    /// Width and height, pixels.
    pub size: Option<(u32, u32)>,
    /// What files they are.
    pub format: Format,
}

/// What file a figure is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// Lines and text, to any size.
    #[default]
    Svg,
    /// Pixels.
    Png,
}

impl Plots {
    /// The time is shown.
    pub(crate) fn shows(&self, t_s: f64) -> bool {
        t_s >= self.from_s && self.to_s.is_none_or(|to_s| t_s <= to_s)
    }
}

/// A figure over time: its name, its title and its panels, each with the name of its axis and what it shows.
struct Figure {
    name: &'static str,
    about: &'static str,
    of: &'static [Source],
    panels: &'static [(&'static str, Quantity)],
}

const FIGURES: [Figure; 7] = [
    Figure {
        name: "uvz",
        about: "w = u + jv and z",
        of: &Source::ALL,
        panels: &[("u", Quantity::U), ("v", Quantity::V), ("z, °", Quantity::Z)],
    },
    Figure {
        name: "v",
        about: "v of gyro, accelerometer and fused",
        of: &[Source::Accel, Source::Gyro, Source::Fused],
        panels: &[("v", Quantity::V)],
    },
    Figure {
        name: "angles",
        about: "yaw, pitch, roll and course",
        of: &Source::ALL,
        panels: &[
            ("yaw ψ, °", Quantity::Yaw),
            ("pitch ϑ, °", Quantity::Pitch),
            ("roll γ, °", Quantity::Roll),
            ("course H, °", Quantity::Course),
        ],
    },
    Figure {
        name: "bias",
        about: "bias of the gyro",
        of: &Source::ALL,
        panels: &[("ξ, °/s", Quantity::BiasX), ("η, °/s", Quantity::BiasY), ("ζ, °/s", Quantity::BiasZ)],
    },
    Figure {
        name: "error",
        about: "error against the reference",
        of: &Source::ALL,
        panels: &[
            ("inclination, °", Quantity::InclinationError),
            ("heading, °", Quantity::HeadingError),
            ("total, °", Quantity::TotalError),
        ],
    },
    Figure {
        name: "signed",
        about: "error of each angle; of a yaw from nowhere how far it has drifted",
        of: &Source::ALL,
        panels: &[
            ("roll γ, °", Quantity::RollError),
            ("pitch ϑ, °", Quantity::PitchError),
            ("yaw ψ, °", Quantity::YawError),
            ("course H, °", Quantity::CourseError),
        ],
    },
    Figure {
        name: "bias-error",
        about: "error of the gyro's bias",
        of: &Source::ALL,
        panels: &[("ξ, °/s", Quantity::BiasXError), ("η, °/s", Quantity::BiasYError), ("ζ, °/s", Quantity::BiasZError)],
    },
];

/// One of the curves of a figure.
struct Series<'a> {
    name: &'a str,
    color: plotters::style::RGBColor,
    style: Style,
    curves: &'a Curves,
}

/// Draws the figures that are asked for into files.
pub(crate) struct Pen<'a> {
    plots: &'a Plots,
    typeface: Option<Typeface>,
}

impl<'a> Pen<'a> {
    pub(crate) fn new(plots: &'a Plots) -> Result<Self, ScoreError> {
        let typeface = match plots.format {
            Format::Svg => None,
            Format::Png => Some(Typeface::find().map_err(|why| ScoreError::Typeface { why })?),
        };
        Ok(Self { plots, typeface })
    }

    /// What one chain of stages did over a trial, its channels beside it; the files' names begin with `place`.
    pub(crate) fn one(&self, place: &Path, trial: &str, launch: &Launch, record: &Record) -> Result<(), ScoreError> {
        let title = format!("{trial}, {}", stages(launch));
        for figure in &FIGURES {
            let series = figure.of.iter().map(|source| {
                let (color, style) = match source {
                    Source::Accel => (SKY, Style::Thin),
                    Source::Gyro => (AMBER, Style::Dashed(12, 4)),
                    Source::Fused => of_place(0),
                    Source::Reference => REFERENCE,
                };
                Series { name: source.name(), color, style, curves: record.of(*source) }
            });
            self.over_time(place, &title, figure, &series.collect::<Vec<_>>())?;
        }
        let sphere = Sphere { title: format!("{title}: the up vector"), ups: &record.path };
        self.file(place, "sphere", SPHERE, &sphere)
    }

    /// What several chains of stages did over a trial, one over the other, with the reference.
    pub(crate) fn all(
        &self,
        place: &Path,
        trial: &str,
        launches: &[Launch],
        records: &[&Record],
    ) -> Result<(), ScoreError> {
        let fused = launches.iter().zip(records).enumerate().map(|(at, (launch, record))| {
            let (color, style) = of_place(at);
            Series { name: &launch.fuser.stage, color, style, curves: record.of(Source::Fused) }
        });
        let (color, style) = REFERENCE;
        let reference = records.first().map(|record| {
            let curves = record.of(Source::Reference);
            Series { name: Source::Reference.name(), color, style, curves }
        });
        let series: Vec<_> = fused.chain(reference).collect();
        let compared = FIGURES.iter().filter(|figure| figure.of.contains(&Source::Reference));
        compared.into_iter().try_for_each(|figure| self.over_time(place, trial, figure, &series))
    }

    /// The error over the range of each setting that was gone through.
    pub(crate) fn sweeps(&self, sweeps: &[Sweep]) -> Result<(), ScoreError> {
        for of_setting in sweeps.chunk_by(|a, b| a.setting == b.setting) {
            let Some(first) = of_setting.first() else { continue };
            let values = || of_setting.iter().flat_map(|sweep| &sweep.curve).map(|point| point.value);
            let (from, to) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
            let unit = if first.unit.is_empty() { String::new() } else { format!(", {}", first.unit) };
            let x = Axis {
                by_factors: crate::tune::goes_by_factors(from, to),
                ..Axis::new(format!("{}{unit}", first.setting), from..to)
            };
            let curves = of_setting.iter().enumerate().map(|(at, sweep)| {
                let (color, style) = of_place(at);
                let points = sweep.curve.iter().map(|point| (point.value, point.error_deg)).collect();
                figures::Curve::new(&sweep.fuser, color, style, points)
            });
            let curves: Vec<_> = curves.collect();
            let errors = || curves.iter().flat_map(|curve| &curve.points).map(|point| point.1);
            let most = errors().fold(0.0, f64::max);
            let y = Axis::new(format!("{} error, °", first.least_of), 0.0..1.05 * most.max(1e-9));
            let chart = Chart { title: String::new(), x, y, curves, named: true };
            let title = format!("{}: mean error of the trials", first.setting);
            let stack = Stack { title, charts: vec![chart] };
            let name = format!("{}.{}", SWEEP, first.setting);
            self.file(&self.plots.folder.join(&name), "", (WIDTH, HEIGHT_ALONE), &stack)?;
        }
        Ok(())
    }

    fn over_time(&self, place: &Path, title: &str, figure: &Figure, series: &[Series<'_>]) -> Result<(), ScoreError> {
        let panel = |(label, quantity): &(&'static str, Quantity)| {
            let drawn = series.iter().map(|series| (series, series.curves.of(*quantity)));
            panel(label, self.plots.from_s, &drawn.filter(|(_, curve)| !curve.is_empty()).collect::<Vec<_>>())
        };
        let charts: Vec<_> = figure.panels.iter().filter_map(panel).collect();
        if charts.is_empty() {
            return Ok(());
        }
        let height = if charts.len() == 1 { HEIGHT_ALONE } else { HEIGHT * charts.len() as u32 };
        let stack = Stack { title: format!("{title}: {}", figure.about), charts };
        self.file(place, figure.name, (WIDTH, height), &stack)
    }

    /// Writes `PLACE.NAME.svg`, or what is asked for.
    fn file(&self, place: &Path, name: &str, usual: (u32, u32), of: &impl Draw) -> Result<(), ScoreError> {
        let size = self.plots.size.unwrap_or(usual);
        let (ending, bytes) = match &self.typeface {
            None => ("svg", figures::svg(size, of).map(String::into_bytes)),
            Some(typeface) => ("png", figures::png(size, of, typeface)),
        };
        let mut path = place.to_path_buf().into_os_string();
        path.push(if name.is_empty() { format!(".{ending}") } else { format!(".{name}.{ending}") });
        let path = PathBuf::from(path);
        let written = bytes.map_err(|cause| io::Error::other(cause.to_string())).and_then(|it| fs::write(&path, it));
        written.map_err(|cause| ScoreError::Write { path, cause })
    }
}

/// What the name of the picture of a setting begins with.
const SWEEP: &str = "sweep";

/// The stages of a chain, in the order of the path.
fn stages(launch: &Launch) -> String {
    let Launch { gyro, accel, fuser, course, .. } = launch;
    format!("{} + {} → {} → {}", gyro.stage, accel.stage, fuser.stage, course.stage)
}

/// The curves over time with some room around them; none of none.
fn panel(label: &'static str, from_s: f64, curves: &[(&Series<'_>, &Curve)]) -> Option<Chart> {
    let ranges = || curves.iter().filter_map(|(_, curve)| curve.range());
    let least = ranges().map(|range| range.0).reduce(f64::min)?;
    let most = ranges().map(|range| range.1).reduce(f64::max)?;
    let room = (0.05 * (most - least)).max(1e-3);
    let end_s = curves.iter().map(|(_, curve)| curve.end_s()).fold(from_s + 1e-3, f64::max);
    let drawn = curves.iter().map(|(Series { name, color, style, .. }, curve)| {
        let broken = |line: &[(f64, f64)]| line.iter().copied().chain([(f64::NAN, f64::NAN)]).collect::<Vec<_>>();
        figures::Curve::new(*name, *color, *style, curve.lines(WRAP).flat_map(broken).collect())
    });
    Some(Chart {
        title: String::new(),
        x: Axis::new("time, s", from_s..end_s),
        y: Axis::new(label, least - room..most + room),
        curves: drawn.collect(),
        named: curves.len() > 1,
    })
}
