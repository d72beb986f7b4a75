//! `plumb import`: converts logs of other systems. Other commands that read recordings also use it.

use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use import::{
    ImportError, Mapping, MappingError, Note, Options, PlainRecording, Progress, Summary, convert,
    mcap_file::to_mcap,
    readable::{Event, ReadableFile, count_references},
};
use indicatif::ProgressBar;
use launch::GyroSamples;

use crate::{
    failure::Outcome,
    notice::{notice, progress_bar},
    stdout::print,
};

/// Arguments of `plumb import`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb import flight.ulg -o flight_imu.csv.gz
  plumb import bag/ --topic /imu/data --topic /gps/vel -o walk.mcap
  plumb import phone.csv -o walk_imu.csv --units ms,deg/s,g --frame flu

PX4 ULog, ArduPilot log, tlog, MCAP and ROS 2 bag need no mapping. For any other
CSV, --map names the column of each quantity: t, gx, gy, gz, ax, ay, az;
optional mx, my, mz (field), qw, qx, qy, qz (reference), ve, vn, vu or vd
(velocity, m/s), lat, lon, alt. If several CSV files are given, a column is
FILE:COLUMN and the files are joined by time. A log whose clock restarts has
several segments, of which one is converted.

The output is MCAP if its name ends in .mcap, else CSV, compressed if it ends in
.gz. Fixes are written next to NAME_imu.csv.gz as NAME_gnss.csv.")]
pub(crate) struct Import {
    /// ULog, ArduPilot log, tlog, MCAP, ROS 2 bag, or CSV files joined by time
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Recording to write: .csv, .csv.gz or .mcap
    #[arg(short, long, value_name = "FILE.csv.gz|FILE.mcap")]
    out: PathBuf,
    #[command(flatten)]
    reading: ReadOptions,
    #[command(flatten)]
    sensors: SensorNumbers,
}

/// Arguments that describe how to read a foreign recording.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Foreign recordings")]
pub(crate) struct ReadOptions {
    /// CSV column of a quantity, such as gx=gyro_x; repeat or use commas
    #[arg(long = "map", value_name = "NAME=COLUMN")]
    maps: Vec<String>,
    /// Units of a CSV, MCAP or bag, in any order [default: rad/s,m/s2,uT,s]
    #[arg(long, value_name = "UNITS")]
    units: Option<String>,
    /// Body axes rfu, frd or flu, or with a reference such as ned-frd
    #[arg(long, value_name = "AXES")]
    frame: Option<String>,
    /// Topic to read if a file has several of one type, repeatable
    #[arg(long = "topic", value_name = "TOPIC")]
    topics: Vec<String>,
    /// Segment to read if the clock of the log jumps back [default: longest]
    #[arg(long, value_name = "N")]
    segment: Option<usize>,
    /// Bits of the CSV's time counter if it wraps, such as 32
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(1..64))]
    time_bits: Option<u8>,
    /// Index of the inertial sensor, from 0 [default: first that works]
    #[arg(long, value_name = "N")]
    imu: Option<usize>,
}

/// Indices of the magnetometer and the receiver to read.
#[derive(Args, Clone, Copy, Default)]
#[command(next_help_heading = "Foreign recordings")]
pub(crate) struct SensorNumbers {
    /// Index of the magnetometer, from 0 [default: first]
    #[arg(long, value_name = "N")]
    pub(crate) mag: Option<usize>,
    /// Index of the receiver, from 0 [default: first]
    #[arg(long, value_name = "N")]
    pub(crate) gnss: Option<usize>,
}

/// Meaning of the rate samples of a recording.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum RateSamples {
    Means,
    Instants,
}

impl From<RateSamples> for GyroSamples {
    fn from(samples: RateSamples) -> Self {
        match samples {
            RateSamples::Means => Self::Means,
            RateSamples::Instants => Self::Instants,
        }
    }
}

impl ReadOptions {
    /// Returns the options of the import.
    pub(crate) fn options(&self, sensors: SensorNumbers) -> Result<Options, MappingError> {
        let Self { maps, units, frame, topics, segment, time_bits, imu } = self;
        let is_mapped = !maps.is_empty() || units.is_some() || frame.is_some() || time_bits.is_some();
        let mapping = is_mapped.then(|| Mapping::parse(maps, units.as_deref(), frame.as_deref())).transpose()?;
        let SensorNumbers { mag, gnss } = sensors;
        let (topics, segment, time_bits, imu) = (topics.clone(), *segment, *time_bits, *imu);
        Ok(Options { mapping, topics, segment, time_bits, imu, mag, gnss })
    }

    /// Returns `true` if any argument is given.
    pub(crate) fn is_set(&self) -> bool {
        let Self { maps, units, frame, topics, segment, time_bits, imu } = self;
        let is_read = segment.is_some() || time_bits.is_some() || imu.is_some();
        !maps.is_empty() || units.is_some() || frame.is_some() || !topics.is_empty() || is_read
    }

    /// Appends the mapping arguments to a source `line` as `key=value` pairs.
    pub(crate) fn apply_to_source(&self, line: &str) -> String {
        let map = (!self.maps.is_empty()).then(|| self.maps.join(","));
        let time_bits = self.time_bits.map(|bits| bits.to_string());
        let (units, frame) = (self.units.clone(), self.frame.clone());
        let keys = [("map", map), ("units", units), ("frame", frame), ("time_bits", time_bits)];
        let given = keys.into_iter().filter_map(|(key, value)| Some((key, value?)));
        given.fold(line.to_owned(), |line, (key, value)| {
            let separator = if line.contains('?') { '&' } else { '?' };
            format!("{line}{separator}{key}={value}")
        })
    }
}

pub(crate) fn run(Import { files, out, reading, sensors }: Import) -> Outcome {
    let options = reading.options(sensors)?;
    let (text, warning) = match out.extension() {
        Some(extension) if extension == "mcap" => write_mcap(&files, &options, &out)?,
        _ => {
            let summary = convert_with_progress(&files, &options, &out)?;
            (summary_text(&summary, &out), summary.warning())
        }
    };
    let code = print(&text);
    warning.iter().for_each(announce_warning);
    Ok(code)
}

/// Imports the files and writes them as MCAP. A native recording is converted without importing it
/// first. Returns the summary and a warning.
fn write_mcap(files: &[PathBuf], options: &Options, out: &Path) -> Result<(String, Option<String>), ImportError> {
    if let [file] = files
        && *options == Options::default()
        && let Some(plain) = PlainRecording::read(file)
    {
        let survey = recording::survey(file)?;
        to_mcap(file, out)?;
        let samples = launch::pluralize(survey.rows, "sample");
        let head = format!("{}: {samples} at {:.1} Hz", foreign::path(out), survey.rate_hz);
        return Ok((with_notes(head, plain.note.as_slice()), None));
    }
    let (readable, summary) = ReadableFile::import(files, options, &mut announcer())?;
    to_mcap(&readable.path, out)?;
    Ok((summary_text(&summary, out), readable.warning))
}

/// Prints a warning on standard error.
fn announce_warning(warning: impl Display) {
    supervisor::announce(format_args!("warning: {warning}"));
}

/// Returns a function that prints the events of an import and shows its progress.
pub(crate) fn announcer() -> impl FnMut(Event<'_>) {
    let mut bar: Option<ProgressBar> = None;
    move |event| match event {
        Event::Progress(Progress { done_bytes, total_bytes }) => {
            let bar = bar.get_or_insert_with(|| progress_bar(0, "{bar:40} {bytes} of {total_bytes}, {eta} left"));
            bar.set_length(total_bytes);
            bar.set_position(done_bytes);
        }
        Event::ImportEnded => bar.take().iter().for_each(ProgressBar::finish_and_clear),
        Event::Imported { path, summary } => notice(summary_text(summary, path)),
        Event::TableNote { path, note } => supervisor::announce(format_args!("{}: {note}", foreign::path(path))),
        // A missing line end may be harmless.
        Event::RecordingNote { path, note: note @ Note::UnendedRow { .. } } => {
            supervisor::announce(format_args!("{}: {note}", foreign::path(path)));
        }
        Event::RecordingNote { path, note } => announce_warning(format_args!("{}: {note}", foreign::path(path))),
        Event::SegmentLeftOut { path, number, samples } => announce_warning(format_args!(
            "{}: left out segment {number}, which has {}",
            foreign::path(path),
            launch::pluralize(samples, "sample")
        )),
    }
}

/// Prints the warning that was deferred to the end of the run, if any.
pub(crate) fn announce_deferred_warning(readable: &ReadableFile) {
    readable.warning.iter().for_each(announce_warning);
}

/// Prints the number of samples with a reference from a separate file.
pub(crate) fn announce_references(readable: &ReadableFile, reference: &Path) {
    // Errors of both files are reported by the run.
    if let Ok([used, rows]) = count_references(&readable.path, reference) {
        let file = foreign::path(&readable.user_path);
        supervisor::announce(format_args!("{file}: {used} of {rows} samples with a reference"));
    }
}

/// Converts the files, with a progress bar if standard error is a terminal.
fn convert_with_progress(files: &[PathBuf], options: &Options, out: &Path) -> Result<Summary, ImportError> {
    let mut announce = announcer();
    let summary = convert(files, options, out, &mut |progress| announce(Event::Progress(progress)));
    announce(Event::ImportEnded);
    summary
}

/// Returns the summary of an import as text.
pub(crate) fn summary_text(summary: &Summary, name: &Path) -> String {
    let Summary { format, rows, rate_hz, duration_s, field_rows, reference_rows, fixes, notes, .. } = summary;
    let (samples, fixes) = (launch::pluralize(*rows, "sample"), launch::pluralize(*fixes, "fix"));
    let head = format!(
        "{}: {format}, {samples} at {rate_hz:.1} Hz in {duration_s:.1} s, {field_rows} with magnetic field, {reference_rows} with reference, {fixes}",
        foreign::path(name)
    );
    with_notes(head, notes)
}

fn with_notes(head: String, notes: &[Note]) -> String {
    notes.iter().fold(head, |text, note| format!("{text}\n  {note}"))
}
