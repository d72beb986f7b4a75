//! Recordings and tables of any format as files that the crate `recording` reads.
//!
//! A recording without faults is read directly. Any other file is imported into a temporary folder
//! first.

use std::path::{Path, PathBuf};

use recording::{RecordingError, References};
use tempfile::TempDir;

use crate::{
    Format, ImportError, Note, Options, PlainRecording, Progress, Segment, Summary, Table, convert, convert_table,
    fixes_notes,
};

/// Minimum number of samples for a segment to have a time interval.
const MIN_SEGMENT_SAMPLES: u64 = 2;

/// Event while recordings and tables are opened.
#[derive(Debug)]
pub enum Event<'a> {
    /// A part of a recording was imported.
    Progress(Progress),
    /// An import has ended, with or without an error.
    ImportEnded,
    /// A recording was imported.
    Imported {
        /// Path of the file that the user named.
        path: &'a Path,
        /// Result of the import.
        summary: &'a Summary,
    },
    /// A table was converted, with a note.
    TableNote {
        /// Path of the file that the user named.
        path: &'a Path,
        /// Skipped or implausible data.
        note: &'a Note,
    },
    /// A recording or its fixes are read without an import, with a note.
    RecordingNote {
        /// Path of the file.
        path: &'a Path,
        /// Possibly incomplete row, or fixes that do not belong to the recording.
        note: &'a Note,
    },
    /// A segment was left out, because it is too short.
    SegmentLeftOut {
        /// Path of the file that the user named.
        path: &'a Path,
        /// Number of the segment, from 1.
        number: usize,
        /// Number of samples.
        samples: u64,
    },
}

/// Recording in a readable format. An imported recording is a temporary file, which is removed on
/// drop.
#[derive(Debug)]
pub struct ReadableFile {
    /// Path of the readable file.
    pub path: PathBuf,
    /// Path of the file that the user named.
    pub user_path: PathBuf,
    /// Warning if less than half of an imported file was used.
    pub warning: Option<String>,
    /// Format of the file that the user named.
    format: Format,
    _folder: Option<TempDir>,
}

impl ReadableFile {
    /// Opens a recording, importing it first if it is a foreign log or some of its rows are
    /// damaged.
    ///
    /// # Errors
    ///
    /// Returns an [`ImportError`] if the file cannot be read or the options do not apply to it. A
    /// file that is damaged from its start is returned, so that its reader reports the damage.
    pub fn open(path: &Path, options: &Options, report: &mut dyn FnMut(Event<'_>)) -> Result<Self, ImportError> {
        Ok(Self::open_with_segments(path, options, report)?.0)
    }

    /// Opens all segments of a recording that have a time interval, or the chosen one.
    ///
    /// # Errors
    ///
    /// Returns the error of the first segment that cannot be read.
    pub fn open_segments(
        path: &Path,
        options: &Options,
        report: &mut dyn FnMut(Event<'_>),
    ) -> Result<Vec<Self>, ImportError> {
        let (first, segments) = Self::open_with_segments(path, options, report)?;
        if segments.len() < 2 || options.segment.is_some() {
            return Ok(vec![first]);
        }
        let numbered = || (1..).zip(&segments);
        for (number, Segment { samples, .. }) in numbered().filter(|(_, segment)| segment.samples < MIN_SEGMENT_SAMPLES)
        {
            report(Event::SegmentLeftOut { path, number, samples: *samples });
        }
        let long = numbered().filter(|(_, segment)| segment.samples >= MIN_SEGMENT_SAMPLES);
        long.map(|(number, _)| {
            let options = Options { segment: Some(number), ..options.clone() };
            Ok(Self::import(&[path.into()], &options, report)?.0)
        })
        .collect()
    }

    /// Opens a recording. Also returns the segments if it was imported.
    fn open_with_segments(
        path: &Path,
        options: &Options,
        report: &mut dyn FnMut(Event<'_>),
    ) -> Result<(Self, Vec<Segment>), ImportError> {
        if *options == Options::default() && is_read_unchanged(path, report)? {
            let (user_path, format) = (path.into(), Format::Recording);
            return Ok((Self { path: path.into(), user_path, warning: None, format, _folder: None }, Vec::new()));
        }
        let (readable, summary) = Self::import(&[path.into()], options, report)?;
        report(Event::Imported { path, summary: &summary });
        Ok((readable, summary.segments))
    }

    /// Imports a foreign log, which may consist of several tables. Also returns the summary.
    ///
    /// # Errors
    ///
    /// Returns an [`ImportError`] if the files cannot be read or the options do not apply to them.
    pub fn import(
        files: &[PathBuf],
        options: &Options,
        report: &mut dyn FnMut(Event<'_>),
    ) -> Result<(Self, Summary), ImportError> {
        let folder = temporary_folder()?;
        let first = files.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
        let name = first.file_stem().unwrap_or_default().to_string_lossy();
        let fixes = recording::gnss::find_for(first);
        let name = match (&fixes, options.segment) {
            (Some(_), _) => name.strip_suffix(".csv").unwrap_or(&name).to_owned(),
            (None, Some(segment)) => format!("{name}_{segment}_imu"),
            (None, None) => format!("{name}_imu"),
        };
        let imported = folder.path().join(format!("{name}.csv"));
        let summary = convert(files, options, &imported, &mut |progress| report(Event::Progress(progress)));
        report(Event::ImportEnded);
        let mut summary = summary?;
        // The fixes of a recording are in a file next to it.
        if let (Some(fixes), None) = (&fixes, &summary.fixes_file) {
            let copy = fixes.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let copy = folder.path().join(copy.strip_suffix(".gz").unwrap_or(&copy));
            summary.notes.extend(convert_table(fixes, Table::Fixes, &copy)?);
            let rows = PlainRecording::read(&imported);
            let notes = rows.map(|rows| fixes_notes(&copy, rows.range_ns)).transpose()?;
            summary.notes.extend(notes.into_iter().flatten());
        }
        let (user_path, warning, format) = (first.to_owned(), summary.warning(), summary.format);
        Ok((Self { path: imported, user_path, warning, format, _folder: Some(folder) }, summary))
    }

    /// Returns `true` if the format of the file defines its axes, so that `--frame` does not apply.
    pub fn has_own_axes(&self) -> bool {
        !self.format.is_text() && !self.format.has_topics()
    }

    /// Replaces the path of a temporary file in a message with that of the user's file.
    pub fn with_user_path(&self, text: &str) -> String {
        replace_path(text, &self.path, &self.user_path)
    }
}

/// Table of fixes or references in a readable form. A converted table is a temporary file, which is
/// removed on drop.
#[derive(Debug)]
pub struct ReadableTable {
    /// Path of the readable file.
    pub path: PathBuf,
    /// Path of the file that the user named.
    user_path: PathBuf,
    _folder: Option<TempDir>,
}

impl ReadableTable {
    /// Opens a table, converting it first if its dialect is not that of a recording.
    ///
    /// A table that cannot be converted is returned unchanged, so that its reader reports the
    /// mistake.
    pub fn open(path: &Path, table: Table, report: &mut dyn FnMut(Event<'_>)) -> Self {
        let unchanged = Self { path: path.to_owned(), user_path: path.to_owned(), _folder: None };
        let unended_line = match table {
            Table::Fixes => recording::gnss::survey(path).map(|survey| survey.unended_line),
            Table::Reference => References::open(path).and_then(|mut table| {
                table.attitude_at(i64::MAX, [0.0; 3])?;
                Ok(table.unended_line())
            }),
        };
        if let Ok(unended_line) = unended_line {
            let note = unended_line.map(|line| Note::UnendedRow { line });
            note.iter().for_each(|note| report(Event::TableNote { path, note }));
            return unchanged;
        }
        if !path.is_file() {
            return unchanged;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // The reader of the table reports why it cannot be read.
        let Ok(folder) = temporary_folder() else { return unchanged };
        let out = folder.path().join(name.strip_suffix(".gz").unwrap_or(&name));
        let Ok(notes) = convert_table(path, table, &out) else { return unchanged };
        notes.iter().for_each(|note| report(Event::TableNote { path, note }));
        Self { path: out, user_path: path.to_owned(), _folder: Some(folder) }
    }

    /// Replaces the path of a temporary file in a message with that of the user's file.
    pub fn with_user_path(&self, text: &str) -> String {
        replace_path(text, &self.path, &self.user_path)
    }
}

fn temporary_folder() -> Result<TempDir, ImportError> {
    let folder = tempfile::Builder::new().prefix("plumb-import-").tempdir();
    folder.map_err(|cause| ImportError::TemporaryFolder { cause })
}

fn replace_path(text: &str, path: &Path, user_path: &Path) -> String {
    text.replace(&foreign::path(path).to_string(), &foreign::path(user_path).to_string())
}

/// Returns the number of rows with a reference from a separate file, and the number of all rows.
///
/// # Errors
///
/// Returns an error if one of the files cannot be read.
pub fn count_references(recording: &Path, reference: &Path) -> Result<[u64; 2], RecordingError> {
    let mut references = References::open(reference)?;
    let mut counts = [0; 2];
    for row in recording::Reader::open(recording)? {
        let row = row?;
        let is_used = references.attitude_at(row.t_ns, row.rate_rad_s)?.is_some();
        counts = [counts[0] + u64::from(is_used), counts[1] + 1];
    }
    Ok(counts)
}

/// Returns `true` if the file is read without an import: a recording without faults, or a file that
/// is damaged from its start, which the reader reports.
fn is_read_unchanged(path: &Path, report: &mut dyn FnMut(Event<'_>)) -> Result<bool, ImportError> {
    let format = match Format::detect(path) {
        Ok(format) => format,
        Err(ImportError::Open { .. }) => return Ok(true),
        Err(error) if !is_unreadable(path) => return Err(error),
        Err(_) => return Ok(true),
    };
    Ok(match format {
        Format::Recording => match PlainRecording::read(path) {
            Some(plain) => {
                if let Some(fixes) = recording::gnss::find_for(path) {
                    // Fixes in another dialect, or with damaged rows, are converted.
                    let Ok(notes) = fixes_notes(&fixes, plain.range_ns) else { return Ok(false) };
                    notes.iter().for_each(|note| report(Event::RecordingNote { path: &fixes, note }));
                }
                plain.note.iter().for_each(|note| report(Event::RecordingNote { path, note }));
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
