//! `plumb import`: converts logs of other systems. Other commands that read recordings also use it.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use import::{Format, ImportError, Mapping, MappingError, Options, Summary, convert, mcap_file::to_mcap};
use indicatif::{ProgressBar, ProgressStyle};
use tempfile::TempDir;

use crate::{failure::fail, stdout::print};

/// Arguments of `plumb import`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb import flight.ulg -o flight_imu.csv.gz
  plumb import bag/ --topic /imu/data --topic /gps/vel -o walk.mcap
  plumb import phone.csv -o walk_imu.csv --map t=time,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz --units ms,deg/s,g --frame flu

PX4 ULog, ArduPilot log, MCAP and ROS 2 bag need no mapping. For any other CSV, --map names
the column of each quantity: t, gx, gy, gz, ax, ay, az; optional mx, my, mz (field),
qw, qx, qy, qz (reference), ve, vn, vu or vd (velocity, m/s), lat, lon, alt.
If several CSV files are given, a column is FILE:COLUMN and the files are joined by time.

The output is MCAP if its name ends in .mcap, else CSV, compressed if it ends in .gz.
Fixes are written next to NAME_imu.csv.gz as NAME_gnss.csv.")]
pub(crate) struct Import {
    /// ULog, ArduPilot log, MCAP, ROS 2 bag, or CSV files joined by time
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Recording to write: .csv, .csv.gz or .mcap
    #[arg(short, long, value_name = "FILE.csv.gz|FILE.mcap")]
    out: PathBuf,
    #[command(flatten)]
    reading: ReadOptions,
}

/// Arguments that describe how to read a foreign recording.
#[derive(Args, Default)]
#[command(next_help_heading = "Foreign recordings")]
pub(crate) struct ReadOptions {
    /// CSV column of a quantity, such as gx=gyro_x; repeat or use commas
    #[arg(long = "map", value_name = "NAME=COLUMN")]
    maps: Vec<String>,
    /// Units of the CSV, in any order [default: rad/s,m/s2,uT,s]
    #[arg(long, value_name = "UNITS", requires = "maps")]
    units: Option<String>,
    /// Body axes rfu, frd or flu, or with a reference such as ned-frd
    #[arg(long, value_name = "AXES", requires = "maps")]
    frame: Option<String>,
    /// Topic to read if a bag or MCAP file has several of a kind, repeatable
    #[arg(long = "topic", value_name = "TOPIC")]
    topics: Vec<String>,
}

impl ReadOptions {
    fn options(&self) -> Result<Options, MappingError> {
        let Self { maps, units, frame, topics } = self;
        let mapping = (!maps.is_empty()).then(|| Mapping::parse(maps, units.as_deref(), frame.as_deref()));
        Ok(Options { mapping: mapping.transpose()?, topics: topics.clone() })
    }

    /// Returns `true` if any argument is given.
    pub(crate) fn is_set(&self) -> bool {
        let Self { maps, units, frame, topics } = self;
        !maps.is_empty() || units.is_some() || frame.is_some() || !topics.is_empty()
    }

    /// Appends the mapping arguments to a source `line` as `key=value` pairs.
    pub(crate) fn apply_to_source(&self, line: &str) -> String {
        let map = (!self.maps.is_empty()).then(|| self.maps.join(","));
        let keys = [("map", map), ("units", self.units.clone()), ("frame", self.frame.clone())];
        let given = keys.into_iter().filter_map(|(key, value)| Some((key, value?)));
        given.fold(line.to_owned(), |line, (key, value)| {
            let separator = if line.contains('?') { '&' } else { '?' };
            format!("{line}{separator}{key}={value}")
        })
    }
}

pub(crate) fn run(Import { files, out, reading }: Import) -> ExitCode {
    let options = reading.options().map_err(ImportError::from);
    let result = options.and_then(|options| match out.extension() {
        Some(extension) if extension == "mcap" => write_mcap(&files, &options, &out),
        _ => convert_with_progress(&files, &options, &out).map(|summary| summary_text(&summary, &out)),
    });
    match result {
        Ok(text) => print(&text),
        Err(error) => fail(&error, error.exit_code()),
    }
}

/// Imports the files and writes them as MCAP. A native recording is converted without importing it
/// first. Returns the summary.
fn write_mcap(files: &[PathBuf], options: &Options, out: &Path) -> Result<String, ImportError> {
    if let [file] = files
        && options.mapping.is_none()
        && Format::detect(file)? == Format::Recording
    {
        let survey = recording::survey(file)?;
        to_mcap(file, out)?;
        let samples = launch::pluralize(survey.rows, "sample");
        return Ok(format!("{}: {samples} at {:.1} Hz", out.display(), survey.rate_hz));
    }
    let (readable, summary) = ReadableFile::import(files, options)?;
    to_mcap(&readable.path, out)?;
    Ok(summary_text(&summary, out))
}

/// Recording in a readable format. An imported recording is a temporary file, which is removed on
/// drop.
pub(crate) struct ReadableFile {
    pub(crate) path: PathBuf,
    _folder: Option<TempDir>,
}

impl ReadableFile {
    /// Opens a recording, importing it first if it is a foreign log.
    ///
    /// A file of unknown format is returned unchanged, so that its reader reports the error.
    pub(crate) fn open(path: &Path, reading: &ReadOptions) -> Result<Self, ImportError> {
        let options = reading.options()?;
        let is_named = options.mapping.is_some() || !options.topics.is_empty();
        let is_readable = |format| matches!(format, Format::Recording | Format::Csv | Format::Gzip);
        if !is_named && Format::detect(path).map_or(true, is_readable) {
            return Ok(Self { path: path.into(), _folder: None });
        }
        let (readable, summary) = Self::import(&[path.into()], &options)?;
        supervisor::announce(summary_text(&summary, path));
        Ok(readable)
    }

    /// Imports a foreign log, which may consist of several tables. Also returns the summary.
    pub(crate) fn import(files: &[PathBuf], options: &Options) -> Result<(Self, Summary), ImportError> {
        let folder = tempfile::Builder::new().prefix("plumb-import-").tempdir();
        let folder = folder.map_err(|cause| ImportError::TemporaryFolder { cause })?;
        let first = files.first().and_then(|path| path.file_stem());
        let name = first.unwrap_or_default().to_string_lossy();
        let imported = folder.path().join(format!("{name}_imu.csv"));
        let summary = convert_with_progress(files, options, &imported)?;
        Ok((Self { path: imported, _folder: Some(folder) }, summary))
    }
}

/// Converts the files, with a progress bar if standard error is a terminal.
fn convert_with_progress(files: &[PathBuf], options: &Options, out: &Path) -> Result<Summary, ImportError> {
    let style = ProgressStyle::with_template("{bar:40} {bytes} of {total_bytes}, {eta} left");
    let bar = ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
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
        name.display()
    );
    notes.iter().fold(head, |text, note| format!("{text}\n  {note}"))
}
