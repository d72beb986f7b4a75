//! Arguments that describe how to read a recording. They are those of the command line.

use std::{collections::BTreeMap, path::PathBuf};

use import::{ImportError, Mapping, Note, Options, Summary, readable::Event};
use pyo3::{prelude::*, types::PyTuple};

use crate::error::value_error;

/// Arguments of an import.
pub(crate) struct ReadArguments<'a> {
    pub(crate) map: Option<BTreeMap<String, String>>,
    pub(crate) units: Option<&'a str>,
    pub(crate) frame: Option<&'a str>,
    pub(crate) topics: Option<Vec<String>>,
    pub(crate) segment: Option<usize>,
    pub(crate) time_bits: Option<u8>,
    pub(crate) imu: Option<usize>,
    pub(crate) mag: Option<usize>,
    pub(crate) gnss: Option<usize>,
}

impl ReadArguments<'_> {
    /// Returns the options of the import.
    pub(crate) fn options(self) -> PyResult<Options> {
        let Self { map, units, frame, topics, segment, time_bits, imu, mag, gnss } = self;
        if let Some(bits) = time_bits.filter(|bits| !(1..64).contains(bits)) {
            return Err(value_error(format_args!("time_bits is {bits}; choose 1 to 63")));
        }
        let is_mapped = map.is_some() || units.is_some() || frame.is_some() || time_bits.is_some();
        let columns: Vec<_> = map.iter().flatten().map(|(name, column)| format!("{name}={column}")).collect();
        let mapping = is_mapped.then(|| Mapping::parse(&columns, units, frame)).transpose().map_err(value_error)?;
        Ok(Options { mapping, topics: topics.unwrap_or_default(), segment, time_bits, imu, mag, gnss })
    }
}

/// Returns the arguments `*files` as paths, at least one.
pub(crate) fn paths(files: &Bound<'_, PyTuple>) -> PyResult<Vec<PathBuf>> {
    let paths: Vec<PathBuf> = files.iter().map(|file| file.extract()).collect::<PyResult<_>>()?;
    if paths.is_empty() { Err(value_error(ImportError::NoFiles)) } else { Ok(paths) }
}

/// Events that are logged while files are opened.
#[derive(Default)]
pub(crate) struct Log {
    /// Result of the import; `None` if the file is read directly.
    pub(crate) summary: Option<Summary>,
    pub(crate) notes: Vec<String>,
    pub(crate) warnings: Vec<String>,
}

impl Log {
    pub(crate) fn record(&mut self, event: Event<'_>) {
        match event {
            Event::Progress(_) | Event::ImportEnded => {}
            Event::Imported { summary, .. } => {
                self.notes.extend(summary.notes.iter().map(ToString::to_string));
                self.warnings.extend(summary.warning());
                self.summary = Some(summary.clone());
            }
            Event::TableNote { path, note } => self.notes.push(format!("{}: {note}", foreign::path(path))),
            // A missing line end may be harmless.
            Event::RecordingNote { path, note: note @ Note::UnendedRow { .. } } => {
                self.notes.push(format!("{}: {note}", foreign::path(path)));
            }
            Event::RecordingNote { path, note } => self.warnings.push(format!("{}: {note}", foreign::path(path))),
            Event::SegmentLeftOut { path, number, samples } => self.warnings.push(format!(
                "{}: left out segment {number}, which has {}",
                foreign::path(path),
                launch::pluralize(samples, "sample")
            )),
        }
    }
}
