//! Figures of a run, as Matveev 2025 draws them: the point w and the turn z over time, the angles, the sphere, the errors.
//!
//! Input: what goes into the slots at a tick and what comes out. Output: SVG files of some 2000 points a curve, whatever the length of
//! the trial. Time: that of the samples, from the first. Failure: a file that cannot be written.
//!
//! | figure | what it shows |
//! | --- | --- |
//! | `NAME.uvz.svg` | u, v and z of gyro, accelerometer, fused and reference |
//! | `NAME.v.svg` | v of gyro, accelerometer and fused in one panel |
//! | `NAME.angles.svg` | yaw, pitch and roll |
//! | `NAME.sphere.svg` | the up vector on the Riemann sphere, and the plane of w |
//! | `NAME.error.svg` | inclination, heading and total error, where there is a reference |

pub(crate) mod curve;
mod panel;
mod record;
mod sphere;

use std::{
    io,
    path::{Path, PathBuf},
};

use ingest::source::Truth;
use messages::{AttitudeOutput, ImuSample};
use plotters::style::RGBColor;
use runtime::ServiceConfig;

use crate::{ScoreError, trial::Trial};
use curve::Curve;
use panel::{Line, Panel};
use record::{Curves, Record, Source};

/// Size of a figure over time, pixels.
const SIZE: (u32, u32) = (1200, 900);
const SIZE_ONE_PANEL: (u32, u32) = (1200, 500);

const GYRO: RGBColor = RGBColor(230, 125, 25);
const ACCEL: RGBColor = RGBColor(150, 190, 225);
const FUSED: RGBColor = RGBColor(20, 80, 160);
const REFERENCE: RGBColor = RGBColor(60, 60, 60);

/// What a run shows.
pub struct Figures {
    place: PathBuf,
    title: String,
    record: Record,
}

impl Figures {
    /// Figures whose names begin with `place`.
    pub fn new(place: PathBuf, trial: &Trial, config: &ServiceConfig) -> Result<Self, ScoreError> {
        let launch = &config.launch;
        let [gyro, accel, fuser] = [&launch.gyro, &launch.accel, &launch.fuser].map(|filling| &filling.stage);
        let title = format!("{}, {gyro} + {accel} → {fuser}", trial.name);
        Ok(Self { place, title, record: Record::new(config, trial.rows)? })
    }

    /// Takes one tick.
    pub fn take(&mut self, sample: &ImuSample, truth: Option<Truth>, output: &AttitudeOutput) {
        self.record.take(sample, truth, output);
    }

    /// Writes the files.
    pub fn write(&mut self) -> Result<(), ScoreError> {
        self.record.finish();
        let record = &self.record;
        let all = &Source::ALL[..];
        let uvz = [
            Panel { label: "u", lines: lines(record, all, |of| &of.u) },
            Panel { label: "v", lines: lines(record, all, |of| &of.v) },
            Panel { label: "z, °", lines: lines(record, all, |of| &of.z_deg) },
        ];
        self.over_time("uvz", "w = u + jv and z", SIZE, &uvz)?;
        let channels = [Source::Accel, Source::Gyro, Source::Fused];
        let v = Panel { label: "v", lines: lines(record, &channels, |of| &of.v) };
        self.over_time("v", "v of gyro, accelerometer and fused", SIZE_ONE_PANEL, &[v])?;
        let angles = [
            Panel { label: "yaw ψ, °", lines: lines(record, all, |of| &of.yaw_deg) },
            Panel { label: "pitch ϑ, °", lines: lines(record, all, |of| &of.pitch_deg) },
            Panel { label: "roll γ, °", lines: lines(record, all, |of| &of.roll_deg) },
        ];
        self.over_time("angles", "yaw, pitch and roll", SIZE, &angles)?;
        if !record.inclination_deg.is_empty() {
            let error = |name, label, curve| Panel { label, lines: vec![Line { name, color: FUSED, curve }] };
            let errors = [
                error("inclination", "inclination, °", &record.inclination_deg),
                error("heading", "heading, °", &record.heading_deg),
                error("total", "total, °", &record.total_deg),
            ];
            self.over_time("error", "error against the reference", SIZE, &errors)?;
        }
        self.file("sphere", |path| sphere::draw(path, &self.title, &record.path))
    }

    fn over_time(&self, name: &str, about: &str, size: (u32, u32), panels: &[Panel<'_>]) -> Result<(), ScoreError> {
        let title = format!("{}: {about}", self.title);
        self.file(name, |path| panel::draw(path, &title, size, panels))
    }

    fn file(&self, name: &str, draw: impl FnOnce(&Path) -> Drawn) -> Result<(), ScoreError> {
        let mut path = self.place.clone().into_os_string();
        path.push(format!(".{name}.svg"));
        let path = PathBuf::from(path);
        draw(&path).map_err(|cause| ScoreError::Write { path, cause: io::Error::other(cause.to_string()) })
    }
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

/// One curve of each of these sources that has it.
fn lines<'a>(record: &'a Record, of: &[Source], curve: impl Fn(&'a Curves) -> &'a Curve) -> Vec<Line<'a>> {
    of.iter()
        .map(|source| Line { name: source.name(), color: color(*source), curve: curve(record.of(*source)) })
        .filter(|line| !line.curve.is_empty())
        .collect()
}

fn color(source: Source) -> RGBColor {
    match source {
        Source::Accel => ACCEL,
        Source::Gyro => GYRO,
        Source::Reference => REFERENCE,
        Source::Fused => FUSED,
    }
}
