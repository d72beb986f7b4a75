//! `plumb info`: shows the contents of a file of any supported format.

use std::{
    fmt,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use flight::{FlightError, FlightInfo};
use import::{Format, ImportError, Segment, Sensor, plain_recording_range_ns};
use recording::{RecordingError, survey};
use serde::Serialize;

use crate::{
    failure::{fail, fail_after_result},
    import::{ReadOptions, ReadableFile, SensorNumbers, summary_text},
    stdout::print,
};

/// Arguments of `plumb info`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb info flight.mcap
  plumb info flight.ulg
  plumb info walk_imu.csv.gz --json

Exit codes: 0 complete, 1 truncated, 3 unreadable.")]
pub(crate) struct Info {
    /// Flight (MCAP), recording (CSV, CSV.gz) or log of another system
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ReadOptions,
    #[command(flatten)]
    sensors: SensorNumbers,
}

#[derive(Debug, thiserror::Error)]
enum InfoError {
    #[error(transparent)]
    Flight(#[from] FlightError),
    #[error(transparent)]
    Import(#[from] ImportError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

/// Summary of a recording that is not a flight.
#[derive(Serialize)]
struct RecordingInfo {
    file: PathBuf,
    format: String,
    rows: u64,
    rate_hz: f64,
    seconds: f64,
    has_reference: bool,
    /// Parts between restarts of the clock.
    segments: Vec<SegmentInfo>,
    sensors: Vec<SensorInfo>,
    /// Skipped, missing or implausible data.
    notes: Vec<String>,
    #[serde(skip)]
    text: String,
}

/// Part of a log between two restarts of the clock.
#[derive(Serialize)]
struct SegmentInfo {
    first_s: f64,
    last_s: f64,
    samples: u64,
}

/// Sensor of a log.
#[derive(Serialize)]
struct SensorInfo {
    /// Option that chooses the sensor, or `default`.
    option: String,
    name: String,
    samples: u64,
    rate_hz: f64,
    state: &'static str,
    is_read: bool,
}

pub(crate) fn run(Info { file, json, reading, sensors }: &Info) -> ExitCode {
    let read = || -> Result<ExitCode, InfoError> {
        Ok(match Format::detect(file)? {
            Format::Mcap if !reading.is_set() => {
                let info = FlightInfo::read(file)?;
                let printed = show(&info, *json);
                if !*json && !flight::is_flight(file) {
                    // Segments, dead sensors and constant times show only in the samples.
                    if let Ok(samples) = read_foreign_log(file, reading, *sensors) {
                        print(&samples);
                    }
                }
                match &info.incomplete {
                    Some(why) => fail_after_result(&format_args!("{}: incomplete: {why}", foreign::path(file)), 1),
                    None => printed,
                }
            }
            Format::Recording if !reading.is_set() && plain_recording_range_ns(file).is_some() => {
                show(&read_recording(file)?, *json)
            }
            _ => show(&read_foreign_log(file, reading, *sensors)?, *json),
        })
    };
    read().unwrap_or_else(|error| fail(&error, 3))
}

fn show<T: Serialize + fmt::Display>(info: &T, json: bool) -> ExitCode {
    // Serialising numbers, strings and maps with string keys cannot fail.
    if json { print(&serde_json::to_string(info).unwrap_or_default()) } else { print(info) }
}

fn read_recording(file: &Path) -> Result<RecordingInfo, RecordingError> {
    let survey = survey(file)?;
    let (rows, rate_hz, has_reference) = (survey.rows, survey.rate_hz, survey.has_reference);
    let seconds = rows.saturating_sub(1) as f64 / rate_hz;
    let reference = if has_reference { "with" } else { "without" };
    let samples = launch::pluralize(rows, "sample");
    let text = format!(
        "{}: {}, {samples} at {rate_hz:.1} Hz, about {seconds:.1} s, {reference} a reference attitude",
        foreign::path(file),
        Format::Recording
    );
    let format = Format::Recording.to_string();
    let (segments, sensors, notes) = Default::default();
    let file = file.to_owned();
    Ok(RecordingInfo { file, format, rows, rate_hz, seconds, has_reference, segments, sensors, notes, text })
}

/// Imports a foreign log and returns its summary.
fn read_foreign_log(file: &Path, reading: &ReadOptions, sensors: SensorNumbers) -> Result<RecordingInfo, ImportError> {
    let (_, summary) = ReadableFile::import(&[file.to_owned()], &reading.options(sensors)?)?;
    let mut text = summary_text(&summary, file);
    let options = ["--imu", "--mag", "--gnss"];
    let count = |option: &str| summary.sensors.iter().filter(|sensor| sensor.option.starts_with(option)).count();
    if options.into_iter().any(|option| count(option) > 1)
        || summary.sensors.iter().any(|sensor| sensor.state != "healthy")
    {
        summary.sensors.iter().for_each(|sensor| text.push_str(&format!("\n  {sensor}")));
    }
    Ok(RecordingInfo {
        file: file.to_owned(),
        format: summary.format.to_string(),
        rows: summary.rows,
        rate_hz: summary.rate_hz,
        seconds: summary.duration_s,
        has_reference: summary.reference_rows > 0,
        segments: summary.segments.iter().map(SegmentInfo::from).collect(),
        sensors: summary.sensors.iter().map(SensorInfo::from).collect(),
        notes: summary.notes.iter().map(ToString::to_string).collect(),
        text,
    })
}

impl From<&Segment> for SegmentInfo {
    fn from(Segment { first_ns, last_ns, samples }: &Segment) -> Self {
        let [first_s, last_s] = [first_ns, last_ns].map(|t_ns| *t_ns as f64 / 1e9);
        Self { first_s, last_s, samples: *samples }
    }
}

impl From<&Sensor> for SensorInfo {
    fn from(sensor: &Sensor) -> Self {
        let Sensor { option, name, samples, rate_hz, state, is_read } = sensor;
        let (option, name) = (option.clone(), name.raw().to_owned());
        Self { option, name, samples: *samples, rate_hz: *rate_hz, state, is_read: *is_read }
    }
}

impl fmt::Display for RecordingInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}
