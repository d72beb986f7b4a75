//! `plumb import`: converts logs of other systems. Other commands that read recordings also use it.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use import::{
    Format, ImportError, Mapping, MappingError, Note, Options, PlainRecording, Segment, Summary, Table, convert,
    convert_table, fixes_notes, mcap_file::to_mcap,
};
use recording::{RecordingError, References};
use tempfile::TempDir;

use crate::{
    failure::fail,
    notice::{notice, progress_bar},
    stdout::print,
};

/// Minimum number of samples of a segment. A segment with fewer samples has no time interval.
const MIN_SEGMENT_SAMPLES: u64 = 2;

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

    /// Returns the same arguments with the given segment.
    fn with_segment(&self, segment: usize) -> Self {
        Self { segment: Some(segment), ..self.clone() }
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

pub(crate) fn run(Import { files, out, reading, sensors }: Import) -> ExitCode {
    let options = reading.options(sensors).map_err(ImportError::from);
    let result = options.and_then(|options| match out.extension() {
        Some(extension) if extension == "mcap" => write_mcap(&files, &options, &out),
        _ => convert_with_progress(&files, &options, &out).map(|summary| {
            let text = summary_text(&summary, &out);
            (text, summary.warning())
        }),
    });
    match result {
        Ok((text, warning)) => {
            let code = print(&text);
            warning.iter().for_each(announce_warning);
            code
        }
        Err(error) => fail(&error, error.exit_code()),
    }
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
    let (readable, summary) = ReadableFile::import(files, options)?;
    to_mcap(&readable.path, out)?;
    Ok((summary_text(&summary, out), summary.warning()))
}

/// Prints a warning on standard error.
fn announce_warning(warning: &String) {
    supervisor::announce(format_args!("warning: {warning}"));
}

/// Recording in a format that can be read directly. An imported recording is a temporary file,
/// which is removed on drop.
pub(crate) struct ReadableFile {
    pub(crate) path: PathBuf,
    /// Path of the file that the user named.
    user_path: PathBuf,
    /// Format of the file that the user named.
    format: Format,
    /// Warning that is printed at the end of the run.
    warning: Option<String>,
    _folder: Option<TempDir>,
}

impl ReadableFile {
    /// Opens a recording, importing it first if it is a foreign log or some of its rows are
    /// damaged.
    pub(crate) fn open(path: &Path, reading: &ReadOptions, sensors: SensorNumbers) -> Result<Self, ImportError> {
        Ok(Self::open_announced(path, reading, sensors)?.0)
    }

    /// Opens all segments of a recording that have a time interval, or only the chosen segment.
    pub(crate) fn open_segments(
        path: &Path,
        reading: &ReadOptions,
        sensors: SensorNumbers,
    ) -> Result<Vec<Self>, ImportError> {
        let (first, segments) = Self::open_announced(path, reading, sensors)?;
        if segments.len() < 2 || reading.segment.is_some() {
            return Ok(vec![first]);
        }
        let numbered = || (1..).zip(&segments);
        for (number, segment) in numbered().filter(|(_, segment)| segment.samples < MIN_SEGMENT_SAMPLES) {
            let samples = launch::pluralize(segment.samples, "sample");
            announce_warning(&format!("{}: left out segment {number}, which has {samples}", foreign::path(path)));
        }
        let long = numbered().filter(|(_, segment)| segment.samples >= MIN_SEGMENT_SAMPLES);
        let segment = |number| {
            let options = reading.with_segment(number).options(sensors)?;
            Ok(Self::import(&[path.into()], &options)?.0)
        };
        long.map(|(number, _)| segment(number)).collect()
    }

    /// Opens a recording. Also returns the segments if it was imported.
    fn open_announced(
        path: &Path,
        reading: &ReadOptions,
        sensors: SensorNumbers,
    ) -> Result<(Self, Vec<Segment>), ImportError> {
        let options = reading.options(sensors)?;
        if options == Options::default() && is_read_unchanged(path)? {
            let (user_path, format) = (path.into(), Format::Recording);
            return Ok((Self { path: path.into(), user_path, format, warning: None, _folder: None }, vec![]));
        }
        let (readable, summary) = Self::import(&[path.into()], &options)?;
        notice(summary_text(&summary, path));
        Ok((readable, summary.segments))
    }

    /// Imports a foreign log, which may consist of several tables. Also returns the summary.
    pub(crate) fn import(files: &[PathBuf], options: &Options) -> Result<(Self, Summary), ImportError> {
        let folder = tempfile::Builder::new().prefix("plumb-import-").tempdir();
        let folder = folder.map_err(|cause| ImportError::TemporaryFolder { cause })?;
        let first = files.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
        let name = first.file_stem().unwrap_or_default().to_string_lossy();
        let fixes = recording::gnss::find_for(first);
        let name = match (&fixes, options.segment) {
            (Some(_), _) => name.strip_suffix(".csv").unwrap_or(&name).to_owned(),
            (None, Some(segment)) => format!("{name}_{segment}_imu"),
            (None, None) => format!("{name}_imu"),
        };
        let imported = folder.path().join(format!("{name}.csv"));
        let mut summary = convert_with_progress(files, options, &imported)?;
        // The fixes of a recording are in a file next to it.
        if let (Some(fixes), None) = (&fixes, &summary.fixes_file) {
            let copy = fixes.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let copy = folder.path().join(copy.strip_suffix(".gz").unwrap_or(&copy));
            summary.notes.extend(convert_table(fixes, Table::Fixes, &copy)?);
            let rows = PlainRecording::read(&imported);
            let notes = rows.map(|rows| fixes_notes(&copy, rows.range_ns)).transpose()?;
            summary.notes.extend(notes.into_iter().flatten());
        }
        let warning = summary.warning();
        let (user_path, format) = (first.to_owned(), summary.format);
        Ok((Self { path: imported, user_path, format, warning, _folder: Some(folder) }, summary))
    }

    /// Returns `true` if the format of the file defines its axes, so that `--frame` does not apply.
    pub(crate) fn has_own_axes(&self) -> bool {
        !self.format.is_text() && !self.format.has_topics()
    }

    /// Replaces the path of a temporary file in a message with the path of the user's file.
    pub(crate) fn with_user_path(&self, text: &str) -> String {
        replace_path(text, &self.path, &self.user_path)
    }

    /// Prints the number of samples with a reference from a separate file.
    pub(crate) fn announce_references(&self, reference: &Path) {
        // Errors in either file are reported by the run.
        if let Ok([used, rows]) = count_references(&self.path, reference) {
            let file = foreign::path(&self.user_path);
            supervisor::announce(format_args!("{file}: {used} of {rows} samples with a reference"));
        }
    }

    /// Prints the warning that was deferred to the end of the run, if any.
    pub(crate) fn announce_warning(&self) {
        self.warning.iter().for_each(announce_warning);
    }
}

/// Table of fixes or references in a form that can be read directly. A converted table is a
/// temporary file, which is removed on drop.
pub(crate) struct ReadableTable {
    pub(crate) path: PathBuf,
    user_path: PathBuf,
    _folder: Option<TempDir>,
}

impl ReadableTable {
    /// Opens a table, converting it first if its dialect is not that of a recording.
    ///
    /// A table that cannot be converted is returned unchanged, so that the reader of the table
    /// reports the error.
    pub(crate) fn open(path: &Path, table: Table) -> Self {
        let unchanged = Self { path: path.to_owned(), user_path: path.to_owned(), _folder: None };
        let unended_line = match table {
            Table::Fixes => recording::gnss::survey(path).map(|survey| survey.unended_line),
            Table::Reference => References::open(path).and_then(|mut table| {
                table.attitude_at(i64::MAX, [0.0; 3])?;
                Ok(table.unended_line())
            }),
        };
        let announce = |note: &Note| supervisor::announce(format_args!("{}: {note}", foreign::path(path)));
        if let Ok(unended_line) = unended_line {
            unended_line.map(|line| Note::UnendedRow { line }).iter().for_each(announce);
            return unchanged;
        }
        if !path.is_file() {
            return unchanged;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // The run reports why the table cannot be read.
        let Ok(folder) = tempfile::Builder::new().prefix("plumb-import-").tempdir() else { return unchanged };
        let out = folder.path().join(name.strip_suffix(".gz").unwrap_or(&name));
        let Ok(notes) = convert_table(path, table, &out) else { return unchanged };
        notes.iter().for_each(announce);
        Self { path: out, user_path: path.to_owned(), _folder: Some(folder) }
    }

    /// Replaces the path of a temporary file in a message with the path of the user's file.
    pub(crate) fn with_user_path(&self, text: &str) -> String {
        replace_path(text, &self.path, &self.user_path)
    }
}

fn replace_path(text: &str, path: &Path, user_path: &Path) -> String {
    text.replace(&foreign::path(path).to_string(), &foreign::path(user_path).to_string())
}

/// Returns the number of rows with a reference from a separate file, and the number of all rows.
fn count_references(recording: &Path, reference: &Path) -> Result<[u64; 2], RecordingError> {
    let mut references = References::open(reference)?;
    let mut counts = [0; 2];
    for row in recording::Reader::open(recording)? {
        let row = row?;
        let is_used = references.attitude_at(row.t_ns, row.rate_rad_s)?.is_some();
        counts = [counts[0] + u64::from(is_used), counts[1] + 1];
    }
    Ok(counts)
}

/// Returns `true` if the file is read without an import. This applies to a recording without
/// faults, and to a file that is damaged from its start, because the reader reports the damage.
fn is_read_unchanged(path: &Path) -> Result<bool, ImportError> {
    let format = match Format::detect(path) {
        Ok(format) => format,
        Err(ImportError::Open { .. }) => return Ok(true),
        Err(error) if !is_unreadable(path) => return Err(error),
        Err(_) => return Ok(true),
    };
    Ok(match format {
        Format::Recording => match PlainRecording::read(path) {
            Some(plain) => {
                let announce = |file: &Path, note: &Note| match note {
                    // A missing line end may be harmless.
                    Note::UnendedRow { .. } => supervisor::announce(format_args!("{}: {note}", foreign::path(file))),
                    note => announce_warning(&format!("{}: {note}", foreign::path(file))),
                };
                if let Some(fixes) = recording::gnss::find_for(path) {
                    // Fixes in another dialect, or with damaged rows, are converted.
                    let Ok(notes) = fixes_notes(&fixes, plain.range_ns) else { return Ok(false) };
                    notes.iter().for_each(|note| announce(&fixes, note));
                }
                plain.note.iter().for_each(|note| announce(path, note));
                true
            }
            None => false,
        },
        Format::Gzip | Format::Zstd => is_unreadable(path),
        _ => false,
    })
}

/// Returns `true` if the file is empty or damaged from its start.
fn is_unreadable(path: &Path) -> bool {
    recording::Reader::open(path).is_err_and(|error| error.is_unreadable())
}

/// Converts the files, with a progress bar if standard error is a terminal.
fn convert_with_progress(files: &[PathBuf], options: &Options, out: &Path) -> Result<Summary, ImportError> {
    let bar = progress_bar(0, "{bar:40} {bytes} of {total_bytes}, {eta} left");
    let summary = convert(files, options, out, &mut |progress| {
        bar.set_length(progress.total_bytes);
        bar.set_position(progress.done_bytes);
    });
    bar.finish_and_clear();
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
