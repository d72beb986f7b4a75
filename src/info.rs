//! `plumb info`: shows the contents of a file of any supported format.

use std::{
    fmt,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use flight::{FlightError, FlightInfo};
use import::{Format, ImportError, plain_recording_range_ns};
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
    #[serde(skip)]
    text: String,
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
    Ok(RecordingInfo { file: file.to_owned(), format, rows, rate_hz, seconds, has_reference, text })
}

/// Imports a foreign log and returns its summary.
fn read_foreign_log(file: &Path, reading: &ReadOptions, sensors: SensorNumbers) -> Result<RecordingInfo, ImportError> {
    let (_, summary) = ReadableFile::import(&[file.to_owned()], &reading.options(sensors)?)?;
    let mut text = summary_text(&summary, file);
    if summary.sensors.len() > 1 {
        summary.sensors.iter().for_each(|sensor| text.push_str(&format!("\n  {sensor}")));
    }
    Ok(RecordingInfo {
        file: file.to_owned(),
        format: summary.format.to_string(),
        rows: summary.rows,
        rate_hz: summary.rate_hz,
        seconds: summary.duration_s,
        has_reference: summary.reference_rows > 0,
        text,
    })
}

impl fmt::Display for RecordingInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}
