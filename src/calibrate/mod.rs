//! `plumb calibrate`: what a sensor unit's own readings say about its errors, as a piece of `launch.toml`.

mod live;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use ::calibrate::{Calibrator, Kind, Known, Refusal, Report};
use ::import::ImportError;
use attitude::calibration::CalibrationError;
use clap::{Args, ValueEnum};
use flight::{FlightError, messages_of};
use indicatif::{ProgressBar, ProgressStyle};
use ingest::source::{Reading, SourceError};
use launch::{GyroSamples, Launch, LaunchError};
use messages::TakenReading;
use observe::readings::{build_on, sample_of};
use score::{
    ScoreError,
    trial::{Gnss, Options, Trial},
};

use crate::{
    fail,
    import::{Readable, Reading as HowRead},
    out::print,
    system::OnBoard,
    up::duration_s,
};
use live::LiveError;

/// The command line of `plumb calibrate`.
#[derive(Args)]
#[command(after_help = "\
Exit codes: 0 a calibration is printed, 1 the readings do not suffice (it is said what is missing), 2 wrong usage, 3 an input file is wrong.\n\n\
What is read are the sensors' own numbers, before [ingest.calibration] and [ingest.mounting].")]
pub(crate) struct Calibrate {
    /// What is calibrated.
    what: What,
    /// A recording (CSV, CSV.gz, a ULog of PX4, a log of ArduPilot, MCAP or a ROS 2 bag), a flight of `--record`, or a simulation, as `sim:s1`.
    #[arg(required_unless_present = "live", conflicts_with = "live")]
    file: Option<String>,
    /// Read a running system in place of a file, with a bar that shows the coverage; it ends when there is enough, or by Ctrl-C.
    #[arg(long)]
    live: bool,
    /// How long a running system is read at most, as `10s`, `2m` [default: 5m].
    #[arg(long = "for", value_name = "TIME", value_parser = duration_s, requires = "live")]
    duration_s: Option<f64>,
    #[command(flatten)]
    system: OnBoard,
    /// The launch file whose [ingest.calibration] stands already: mounting, clock and an accelerometer in motion build on it [default: none; with --live the running system's].
    #[arg(long, value_name = "FILE", conflicts_with = "live")]
    launch: Option<PathBuf>,
    /// Gravity of the place, m/s² [default: 9.80665].
    #[arg(long, value_name = "M_S2", value_parser = gravity)]
    gravity: Option<f64>,
    /// Strength of the earth's field at the place, µT [default: the mean that is found].
    #[arg(long, value_name = "UT", value_parser = strength)]
    field_ut: Option<f64>,
    /// What a rate sample is: the mean of its interval, or the value at its end [default: means; a simulation and a running system say it].
    #[arg(long, value_name = "means|instants", conflicts_with = "live")]
    gyro_samples: Option<Samples>,
    #[command(flatten)]
    reading: HowRead,
}

#[derive(Clone, Copy, ValueEnum)]
enum What {
    /// Bias, at rest.
    Gyro,
    /// Bias and scale by rests in six positions, each side up once; misalignment, too, by twelve of any kind. Or in motion, turned slowly by hand.
    Accel,
    /// Hard and soft iron, turned about all axes.
    Mag,
    /// How the unit sits in the body, by a level pose and then a nose-down one.
    Mounting,
    /// How late the magnetometer is on the gyro, turned to and fro.
    Clock,
}

#[derive(Clone, Copy, ValueEnum)]
enum Samples {
    Means,
    Instants,
}

/// Why nothing is calibrated.
#[derive(Debug, thiserror::Error)]
enum CalibrateError {
    #[error(transparent)]
    Import(#[from] ImportError),
    #[error(transparent)]
    Trial(Box<ScoreError>),
    #[error(transparent)]
    Flight(#[from] FlightError),
    #[error("calibrating from {}: the flight has no readings, only samples that are calibrated already; record it by `plumb up --record`", file.display())]
    NoReadings { file: PathBuf },
    #[error(transparent)]
    Launch(#[from] LaunchError),
    #[error(transparent)]
    Source(#[from] SourceError),
    #[error("calibrating: [ingest.calibration] of the launch file: {0}")]
    Calibration(#[from] CalibrationError),
    #[error(transparent)]
    Live(#[from] LiveError),
    #[error(transparent)]
    Refused(#[from] Refusal),
}

impl From<ScoreError> for CalibrateError {
    fn from(error: ScoreError) -> Self {
        Self::Trial(error.into())
    }
}

impl CalibrateError {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Import(error) => error.exit_code(),
            Self::Trial(error) => error.exit_code(),
            Self::Flight(_) | Self::NoReadings { .. } | Self::Launch(_) | Self::Calibration(_) => 3,
            Self::Live(error) => error.exit_code(),
            Self::Source(_) | Self::Refused(_) => 1,
        }
    }
}

pub(crate) fn run(calibrate: Calibrate) -> ExitCode {
    let json = calibrate.system.json;
    match calibrated(calibrate) {
        // Numbers, strings and lists always serialise.
        Ok(report) if json => print(&serde_json::to_string(&report).unwrap_or_default()),
        Ok(report) => print(&report),
        Err(error) => fail(&error, error.exit_code()),
    }
}

fn calibrated(calibrate: Calibrate) -> Result<Report, CalibrateError> {
    let Calibrate { what, file, duration_s, system, launch, gravity, field_ut, gyro_samples, reading, .. } = calibrate;
    let kind = match what {
        What::Gyro => Kind::Gyro,
        What::Accel => Kind::Accel,
        What::Mag => Kind::Mag,
        What::Mounting => Kind::Mounting,
        What::Clock => Kind::Clock,
    };
    let mut known = Known { field_ut, ..Known::default() };
    known.gravity_m_s2 = gravity.unwrap_or(known.gravity_m_s2);
    let Some(file) = file else { return Ok(live::calibrated(kind, known, &system.name(), duration_s)?) };
    if let Some(launch) = launch {
        build_on(&mut known, &Launch::read(&launch)?)?;
    }
    let gyro_samples = gyro_samples.map(|samples| match samples {
        Samples::Means => GyroSamples::Means,
        Samples::Instants => GyroSamples::Instants,
    });
    if flight::is_flight(Path::new(&file)) {
        return of_flight(kind, known, Path::new(&file), gyro_samples);
    }
    // What is imported is there until the end.
    let readable = match file.starts_with("sim:") {
        true => None,
        false => Some(Readable::of(Path::new(&file), &reading)?),
    };
    let name = readable.as_ref().map_or(file, |readable| readable.path.to_string_lossy().into_owned());
    let trial = Trial::open(&name, &Options { gnss: Gnss::Off, gyro_samples, ..Options::default() })?;
    known.rate_kind = trial.gyro_samples.rate_kind();
    let mut calibrator = Calibrator::new(kind, &known);
    let bar = ProgressBar::new(trial.rows).with_style(style("{bar:40} {percent:>3} % of {human_len} samples"));
    for (row, reading) in (1u64..).zip(trial.readings()?) {
        calibrator.take(&sample_of(&reading?));
        if row.is_multiple_of(4096) {
            bar.set_position(row);
        }
    }
    bar.finish_and_clear();
    Ok(calibrator.finish()?)
}

/// A flight has the readings as they were, and the launch file that says what they are.
fn of_flight(
    kind: Kind,
    mut known: Known,
    file: &Path,
    gyro_samples: Option<GyroSamples>,
) -> Result<Report, CalibrateError> {
    known.rate_kind = gyro_samples.unwrap_or(GyroSamples::Means).rate_kind();
    let mut calibrator = Calibrator::new(kind, &known);
    let mut readings = messages_of::<TakenReading>(file)?.peekable();
    if readings.peek().is_none() {
        return Err(CalibrateError::NoReadings { file: file.into() });
    }
    for taken in readings {
        calibrator.take(&sample_of(&Reading::from(&taken?)));
    }
    Ok(calibrator.finish()?)
}

/// Drawn on standard error, and only on a terminal.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// From the equator to the poles, and on no mountain less.
fn gravity(text: &str) -> Result<f64, String> {
    number(text, 9.7..=9.9).ok_or_else(|| "expected 9.7 to 9.9".into())
}

fn strength(text: &str) -> Result<f64, String> {
    number(text, 15.0..=75.0).ok_or_else(|| "expected 15 to 75, the strengths that the earth's field has".into())
}

fn number(text: &str, range: std::ops::RangeInclusive<f64>) -> Option<f64> {
    text.parse().ok().filter(|number| range.contains(number))
}
