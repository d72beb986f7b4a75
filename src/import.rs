//! `plumb import`: recordings of other systems, made into ours; and the same on the way, where a command reads one.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use import::{Format, ImportError, Mapping, MappingError, Options, Summary, convert, mcap_file::to_mcap};
use indicatif::{ProgressBar, ProgressStyle};
use tempfile::TempDir;

use crate::{fail, out::print};

/// The command line of `plumb import`.
#[derive(Args)]
#[command(after_help = "\
A ULog of PX4, a log of ArduPilot, an MCAP file and a bag of ROS 2 need no more than their name. Of any other CSV --map says which column is \
what: t, gx, gy, gz, ax, ay, az and, where they are known, mx, my, mz (field), qw, qx, qy, qz (reference), ve, vn, vu or vd (velocity, m/s) and \
lat, lon, alt. A column of one of several files is FILE:COLUMN.")]
pub(crate) struct Import {
    /// A ULog, a log of ArduPilot, an MCAP file, a bag of ROS 2, or CSV files that are joined by time.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The recording to write: MCAP where its name ends in .mcap, else CSV, gzip where it ends in .gz; the fixes of a CSV go beside it
    /// where it is called NAME_imu.csv.gz.
    #[arg(short, long, value_name = "FILE.csv.gz|FILE.mcap")]
    out: PathBuf,
    #[command(flatten)]
    reading: Reading,
}

/// How a recording of another system is read.
#[derive(Args, Default)]
#[command(next_help_heading = "Recordings of others")]
pub(crate) struct Reading {
    /// Which column of a CSV is what, as `gx=gyro_x`; several with commas between them, or again.
    #[arg(long = "map", value_name = "NAME=COLUMN")]
    maps: Vec<String>,
    /// Units of rate, force, field and time, in any order: rad/s or deg/s, m/s2 or g, uT, nT, gauss or mT, s, ms, us or ns.
    #[arg(long, value_name = "UNITS", requires = "maps")]
    units: Option<String>,
    /// Body axes of the file: rfu, frd or flu; with a reference after its axes of the earth, as enu-flu or ned-frd.
    #[arg(long, value_name = "AXES", requires = "maps")]
    frame: Option<String>,
    /// A topic to read of a bag or an MCAP file that has several of a kind; again for another kind.
    #[arg(long = "topic", value_name = "TOPIC")]
    topics: Vec<String>,
}

impl Reading {
    fn options(&self) -> Result<Options, MappingError> {
        let Self { maps, units, frame, topics } = self;
        let mapping = (!maps.is_empty()).then(|| Mapping::parse(maps, units.as_deref(), frame.as_deref()));
        Ok(Options { mapping: mapping.transpose()?, topics: topics.clone() })
    }

    /// Something was said of what is read.
    pub(crate) fn is_said(&self) -> bool {
        let Self { maps, units, frame, topics } = self;
        !maps.is_empty() || units.is_some() || frame.is_some() || !topics.is_empty()
    }

    /// The line of a source that sends such lines: what is said here, as keys of its section.
    pub(crate) fn source(&self, line: &str) -> String {
        let map = (!self.maps.is_empty()).then(|| self.maps.join(","));
        let keys = [("map", map), ("units", self.units.clone()), ("frame", self.frame.clone())];
        let said = keys.into_iter().filter_map(|(key, value)| Some((key, value?)));
        said.fold(line.to_owned(), |line, (key, value)| {
            let sign = if line.contains('?') { '&' } else { '?' };
            format!("{line}{sign}{key}={value}")
        })
    }
}

pub(crate) fn run(Import { files, out, reading }: Import) -> ExitCode {
    let options = reading.options().map_err(ImportError::from);
    let said = options.and_then(|options| match out.extension() {
        Some(extension) if extension == "mcap" => as_mcap(&files, &options, &out),
        _ => with_a_bar(&files, &options, &out).map(|summary| told(&summary, &out)),
    });
    match said {
        Ok(said) => print(&said),
        Err(error) => fail(&error, error.exit_code()),
    }
}

/// Imports, or takes a recording of ours as it is, and writes it as MCAP; what came of it, for people.
fn as_mcap(files: &[PathBuf], options: &Options, out: &Path) -> Result<String, ImportError> {
    if let [file] = files
        && options.mapping.is_none()
        && Format::of(file)? == Format::Recording
    {
        let survey = recording::survey(file)?;
        to_mcap(file, out)?;
        let samples = launch::pluralize(survey.rows, "sample");
        return Ok(format!("{}: {samples} at {:.1} Hz", out.display(), survey.rate_hz));
    }
    let (readable, summary) = Readable::imported(files, options)?;
    to_mcap(&readable.path, out)?;
    Ok(told(&summary, out))
}

/// A recording that is read where another system's was named; it goes when this is dropped.
pub(crate) struct Readable {
    pub(crate) path: PathBuf,
    _folder: Option<TempDir>,
}

impl Readable {
    /// What is to be read for `path`: what is imported of the log of another system; else itself, whose reader says what is wrong with it.
    pub(crate) fn of(path: &Path, reading: &Reading) -> Result<Self, ImportError> {
        let options = reading.options()?;
        let is_named = options.mapping.is_some() || !options.topics.is_empty();
        let is_readable = |format| matches!(format, Format::Recording | Format::Csv | Format::Gzip);
        if !is_named && Format::of(path).map_or(true, is_readable) {
            return Ok(Self { path: path.into(), _folder: None });
        }
        let (readable, summary) = Self::imported(&[path.into()], &options)?;
        supervisor::announce(told(&summary, path));
        Ok(readable)
    }

    /// What is imported of the log of another system, or of tables that belong together, and what came of it.
    pub(crate) fn imported(files: &[PathBuf], options: &Options) -> Result<(Self, Summary), ImportError> {
        let folder = tempfile::Builder::new().prefix("plumb-import-").tempdir();
        let folder = folder.map_err(|cause| ImportError::Folder { cause })?;
        let first = files.first().and_then(|path| path.file_stem());
        let name = first.unwrap_or_default().to_string_lossy();
        let imported = folder.path().join(format!("{name}_imu.csv"));
        let summary = with_a_bar(files, options, &imported)?;
        Ok((Self { path: imported, _folder: Some(folder) }, summary))
    }
}

/// Imports, with a bar on standard error where that is a terminal.
fn with_a_bar(files: &[PathBuf], options: &Options, out: &Path) -> Result<Summary, ImportError> {
    let style = ProgressStyle::with_template("{bar:40} {bytes} of {total_bytes}, {eta} left");
    let bar = ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let summary = convert(files, options, out, &mut |progress| {
        bar.set_length(progress.total_bytes);
        bar.set_position(progress.done_bytes);
    });
    bar.finish_and_clear();
    summary
}

/// What came of an import, for people.
pub(crate) fn told(summary: &Summary, name: &Path) -> String {
    let Summary { format, rows, rate_hz, duration_s, field_rows, reference_rows, fixes, notes, .. } = summary;
    let (samples, fixes) = (launch::pluralize(*rows, "sample"), launch::pluralize(*fixes, "fix"));
    let head = format!(
        "{}: {format}, {samples} at {rate_hz:.1} Hz in {duration_s:.1} s, {field_rows} with a field, {reference_rows} with a reference, {fixes}",
        name.display()
    );
    notes.iter().fold(head, |text, note| format!("{text}\n  {note}"))
}
