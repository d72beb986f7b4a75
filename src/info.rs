//! `plumb info`: shows the contents of a file of any supported format.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use clap::Args;
use flight::FlightInfo;
use import::{Format, ImportError, PlainRecording, Segment, Sensor, readable::ReadableFile};
use recording::{RecordingError, survey};
use serde::Serialize;

use crate::{
    failure::{Failure, Outcome, fail_after_result},
    import::{ReadOptions, SensorNumbers, announcer, summary_text},
    stdout::{print, print_result},
};

/// Arguments of `plumb info`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb info flight.mcap
  plumb info flight.ulg
  plumb info walk_imu.csv.gz --json

Exit codes: 0 complete, 1 truncated, 2 options needed, 3 unreadable.")]
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

/// Summary of a recording that is not a flight.
#[derive(Serialize)]
struct RecordingInfo {
    file: PathBuf,
    format: String,
    rows: u64,
    rate_hz: f64,
    seconds: f64,
    has_reference: bool,
    /// Segments between restarts of the clock.
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

pub(crate) fn run(Info { file, json, reading, sensors }: &Info) -> Outcome {
    let unreadable = |error: ImportError| Failure::new(&error, if error.exit_code() == 2 { 2 } else { 3 });
    let read_samples = || read_foreign_log(file, reading, *sensors);
    let format = Format::detect(file).map_err(unreadable)?;
    if format == Format::Mcap && !reading.is_set() {
        let info = FlightInfo::read(file)?;
        let printed = print_result(&info, *json);
        if !*json && !flight::is_flight(file) {
            // Segments, dead sensors and constant timestamps are detected only from the samples.
            if let Ok(samples) = read_samples() {
                print(&samples);
            }
        }
        return Ok(match &info.incomplete {
            Some(why) => fail_after_result(&format_args!("{}: incomplete: {why}", foreign::path(file)), 1),
            None => printed,
        });
    }
    let is_plain = format == Format::Recording && !reading.is_set();
    let info = match is_plain.then(|| PlainRecording::read(file)).flatten() {
        Some(plain) => read_recording(file, &plain)?,
        None => read_samples().map_err(unreadable)?,
    };
    Ok(print_result(&info, *json))
}

fn read_recording(file: &Path, plain: &PlainRecording) -> Result<RecordingInfo, RecordingError> {
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
    let mut notes = missing_values(file)?;
    notes.extend(plain.note.as_ref().map(ToString::to_string));
    let text = notes.iter().fold(text, |text, note| format!("{text}\n  {note}"));
    let format = Format::Recording.to_string();
    let (segments, sensors) = Default::default();
    let file = file.to_owned();
    Ok(RecordingInfo { file, format, rows, rate_hz, seconds, has_reference, segments, sensors, notes, text })
}

/// Returns a note for each quantity with missing values, which are stored as non-finite numbers.
fn missing_values(file: &Path) -> Result<Vec<String>, RecordingError> {
    let (mut rows, mut without_rate, mut without_force) = (0, 0, 0);
    for row in recording::Reader::open(file)? {
        let row = row?;
        let lacks = |vector: [f64; 3]| u64::from(!vector.iter().all(|number| number.is_finite()));
        rows += 1;
        without_rate += lacks(row.rate_rad_s);
        without_force += lacks(row.force_m_s2);
    }
    let counts = [("rate", without_rate), ("force", without_force)].into_iter().filter(|(_, count)| *count > 0);
    Ok(counts.map(|(what, count)| format!("{count} of {rows} samples without {what}")).collect())
}

/// Imports a foreign log and returns its summary.
fn read_foreign_log(file: &Path, reading: &ReadOptions, sensors: SensorNumbers) -> Result<RecordingInfo, ImportError> {
    let (_, summary) = ReadableFile::import(&[file.to_owned()], &reading.options(sensors)?, &mut announcer())?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_without_rate_or_force_are_counted() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let rows = "0,0,0,0,0,0,9.8\n0.01,nan,0,0,0,0,9.8\n0.02,nan,nan,nan,0,0,inf\n";
        std::fs::write(&file, format!("t_s,gx,gy,gz,ax,ay,az\n{rows}")).unwrap();
        let read = || read_recording(file.path(), &PlainRecording::read(file.path()).unwrap()).unwrap();
        let info = read();
        assert_eq!(info.notes, ["2 of 3 samples without rate", "1 of 3 samples without force"]);
        assert!(
            info.text.ends_with("\n  2 of 3 samples without rate\n  1 of 3 samples without force"),
            "{}",
            info.text
        );
        std::fs::write(&file, "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n").unwrap();
        assert_eq!(read().notes, Vec::<String>::new());
    }
}
