//! `plumb calibrate`: estimates the errors of a sensor unit from its own readings and prints them
//! as sections of `launch.toml`.

mod live;
mod plot;

use std::{
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use ::calibrate::{
    Calibrator, Kind, Prior, Report,
    noise::{NoiseCalibrator, NoiseReport},
};
use ::import::readable::ReadableFile;
use clap::{Args, ValueEnum};
use flight::read_messages;
use launch::{GyroSamples, Launch, write_sections};
use messages::TakenReading;
use observe::readings::{apply_calibrations, to_sample};
use readings::source::Reading;
use score::trial::{Gnss, Trial, TrialOptions};
use serde::Serialize;

use crate::{
    duration::duration,
    failure::{Failure, OrFail as _, Outcome},
    import::{RateSamples, ReadOptions, SensorNumbers, announcer},
    notice::{notice, progress_bar},
    stdout::{print, print_result},
    system::LocalSystemArgs,
};

/// Arguments of `plumb calibrate`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb calibrate gyro flight.csv
  plumb calibrate accel --live --for 10m --write launch.toml
  plumb calibrate noise rest.csv --plot noise.svg --launch launch.toml

Input: CSV, CSV.gz, PX4 ULog, ArduPilot log, MCAP, ROS 2 bag, a recorded flight,
or a simulation sim:SCENARIO. Readings are used as measured, before
[ingest.calibration] and [ingest.mounting]. The existing calibration, from
--launch or --live, is used by mounting, clock and accel in motion.

accel needs a rest with each of the six sides up, or twelve rests in any
position to include misalignment, or slow rotation by hand. noise needs a file
with a rest of 30 s to hours at a constant rate. It prints parameters of the
fuser in --launch or --write.

--live ends when the coverage suffices. --write keeps the comments of the file.
A running system uses the new calibration after a restart.

Exit codes: 0 calibration printed, 1 insufficient readings, 2 wrong usage, 3
invalid input file.")]
#[command(
    mut_arg("system", |system| system.requires("live")),
    mut_arg("launch", |launch| {
        launch.help("Launch file of the sensors [default: none, with --live ./launch.toml]")
    })
)]
pub(crate) struct Calibrate {
    /// Errors to estimate
    target: CalibrationTarget,
    /// Recording, flight or simulation such as sim:s1
    #[arg(required_unless_present = "live", conflicts_with = "live")]
    file: Option<String>,
    /// Read a running system instead of a file, with a progress bar
    #[arg(long)]
    live: bool,
    /// Maximum time of --live, such as 10s or 2m [default: 5m]
    #[arg(long = "for", value_name = "TIME", value_parser = duration, requires = "live")]
    duration: Option<Duration>,
    #[command(flatten)]
    system: LocalSystemArgs,
    /// Launch file to change or create; also read if there is no --launch
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// SVG file for the Allan deviations of noise
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Local gravity, m/s², 9.7 to 9.9 [default: 9.80665]
    #[arg(long, value_name = "M_S2", value_parser = parse_gravity)]
    gravity: Option<f64>,
    /// Local strength of the earth's field, µT, 15 to 75 [default: mean]
    #[arg(long, value_name = "UT", value_parser = parse_field_strength)]
    field_ut: Option<f64>,
    /// Meaning of a rate sample: mean or end value [default: means]
    #[arg(long, value_name = "means|instants", conflicts_with = "live")]
    gyro_samples: Option<RateSamples>,
    #[command(flatten)]
    reading: ReadOptions,
}

#[derive(Clone, Copy, ValueEnum)]
enum CalibrationTarget {
    /// Gyro bias, from a rest
    Gyro,
    /// Accelerometer bias and scale from six rests, or from slow rotation
    Accel,
    /// Hard and soft iron, from rotation about all axes
    Mag,
    /// Orientation of the unit in the body, from a level and a nose-down pose
    Mounting,
    /// Delay of the magnetometer relative to the gyro, from shaking
    Clock,
    /// Random walks and bias instability of gyro and accelerometer, from a long rest
    Noise,
}

impl CalibrationTarget {
    /// Returns the kind of calibration; `None` for the noise, which a separate calibrator
    /// determines.
    fn kind(self) -> Option<Kind> {
        match self {
            Self::Gyro => Some(Kind::Gyro),
            Self::Accel => Some(Kind::Accel),
            Self::Mag => Some(Kind::Mag),
            Self::Mounting => Some(Kind::Mounting),
            Self::Clock => Some(Kind::Clock),
            Self::Noise => None,
        }
    }
}

/// Collects readings for a calibration.
enum Collector {
    Errors(Calibrator),
    /// Noise calibrator, and the name of the fuser stage for which parameters are computed.
    Noise(NoiseCalibrator, String),
}

impl Collector {
    fn push(&mut self, reading: &Reading) {
        match self {
            Self::Errors(calibrator) => calibrator.push(&to_sample(reading)),
            Self::Noise(calibrator, _) => calibrator.push(&to_sample(reading)),
        }
    }

    fn finish(&self) -> Result<Calibration, Failure> {
        Ok(match self {
            Self::Errors(calibrator) => Calibration::Errors(calibrator.finish()?),
            Self::Noise(calibrator, fuser) => Calibration::Noise(calibrator.finish(fuser)?),
        })
    }
}

/// Result of a calibration.
#[derive(Serialize)]
#[serde(untagged)]
enum Calibration {
    Errors(Report),
    Noise(NoiseReport),
}

impl Calibration {
    /// Returns the section for the launch file; empty if there is nothing to set.
    fn block(&self) -> &str {
        match self {
            Self::Errors(report) => &report.block,
            Self::Noise(report) => &report.block,
        }
    }

    fn summary(&self) -> String {
        match self {
            Self::Errors(report) => report.summary(),
            Self::Noise(report) => report.summary(),
        }
    }
}

impl fmt::Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Errors(report) => report.fmt(f),
            Self::Noise(report) => report.fmt(f),
        }
    }
}

pub(crate) fn run(mut args: Calibrate) -> Outcome {
    let (json, write, plot) = (args.system.json, args.write.clone(), args.plot.take());
    if plot.is_some() && args.target.kind().is_some() {
        return Err(Failure::new("--plot draws Allan deviations; use it with `plumb calibrate noise`", 2));
    }
    let calibration = collect(args)?;
    if let (Some(file), Calibration::Noise(report)) = (plot, &calibration) {
        let failed = |cause| format!("drawing {}: {cause}; check the folder", foreign::path(&file));
        plot::write(&file, report).map_err(failed).or_fail(1)?;
    }
    let write = write.filter(|_| !calibration.block().is_empty());
    if let Some(file) = &write {
        // If the file cannot be written, the result must not be lost.
        write_sections(file, calibration.block()).inspect_err(|_| supervisor::announce(&calibration))?;
        notice(format_args!("wrote the calibration to {}", foreign::path(file)));
    }
    Ok(match write {
        Some(_) if !json => print(&calibration.summary().trim_end()),
        _ => print_result(&calibration, json),
    })
}

/// Reads the readings and computes the calibration.
fn collect(args: Calibrate) -> Result<Calibration, Failure> {
    let Calibrate { target, file, duration, system, write, gravity, field_ut, gyro_samples, reading, .. } = args;
    let mut known = Prior { field_ut, ..Prior::default() };
    known.gravity_m_s2 = gravity.unwrap_or(known.gravity_m_s2);
    let Some(file) = file else {
        let no_kind = || {
            let message = "noise needs a recording of a rest instead of --live; record one with `plumb up --record` and pass the flight";
            Failure::new(message, 2)
        };
        let kind = target.kind().ok_or_else(no_kind)?;
        return Ok(Calibration::Errors(live::calibrate_system(kind, known, &system.name()?, duration)?));
    };
    let launch = system
        .selection
        .launch
        .launch
        .or(write.filter(|file| file.exists()))
        .map(|file| Launch::read(&file))
        .transpose()?;
    if let Some(launch) = &launch {
        let applied = apply_calibrations(&mut known, launch);
        applied.map_err(|error| format!("invalid [ingest.calibration] in the launch file: {error}")).or_fail(3)?;
    }
    let collector = |known: &Prior| match target.kind() {
        Some(kind) => Collector::Errors(Calibrator::new(kind, known)),
        None => Collector::Noise(
            NoiseCalibrator::default(),
            launch.as_ref().map_or_else(|| Launch::default().fuser.stage, |launch| launch.fuser.stage.clone()),
        ),
    };
    let gyro_samples = gyro_samples.map(GyroSamples::from);
    if flight::is_flight(Path::new(&file)) {
        known.rate_kind = gyro_samples.unwrap_or(GyroSamples::Means).rate_kind();
        return read_flight(Path::new(&file), collector(&known));
    }
    // An imported recording is a temporary file that is removed on drop, so it is kept until the
    // end of the run.
    let readable = match file.starts_with("sim:") {
        true => None,
        false => {
            let options = reading.options(SensorNumbers::default())?;
            Some(ReadableFile::open(Path::new(&file), &options, &mut announcer())?)
        }
    };
    let name = readable.as_ref().map_or(file, |readable| readable.path.to_string_lossy().into_owned());
    let trial = Trial::open(&name, &TrialOptions { gnss: Gnss::Off, gyro_samples, ..TrialOptions::default() })?;
    known.rate_kind = trial.gyro_samples.rate_kind();
    let mut collector = collector(&known);
    let bar = progress_bar(trial.rows, "{bar:40} {percent:>3} % of {human_len} samples");
    for (row, reading) in (1u64..).zip(trial.readings()?) {
        collector.push(&reading?);
        if row.is_multiple_of(4096) {
            bar.set_position(row);
        }
    }
    bar.finish_and_clear();
    collector.finish()
}

/// Calibrates from the raw readings recorded in a flight.
fn read_flight(file: &Path, mut collector: Collector) -> Result<Calibration, Failure> {
    let mut readings = read_messages::<TakenReading>(file)?.peekable();
    if readings.peek().is_none() {
        let reason = "has no readings, only calibrated samples; record the flight with `plumb up --record`";
        return Err(Failure::new(format_args!("{} {reason}", foreign::path(file)), 3));
    }
    for taken in readings {
        collector.push(&Reading::from(&taken?));
    }
    collector.finish()
}

/// Parses the local gravity in m/s², within the range found on Earth.
fn parse_gravity(text: &str) -> Result<f64, String> {
    parse_in_range(text, 9.7..=9.9).ok_or_else(|| "expected a gravity of 9.7 to 9.9 m/s²".into())
}

fn parse_field_strength(text: &str) -> Result<f64, String> {
    parse_in_range(text, 15.0..=75.0).ok_or_else(|| "expected a field strength of 15 to 75 µT".into())
}

fn parse_in_range(text: &str, range: std::ops::RangeInclusive<f64>) -> Option<f64> {
    text.parse().ok().filter(|number| range.contains(number))
}
