//! Conversion of recordings of other systems into a Plumbline recording.

use std::{
    fs,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use recording::{
    Layout, Writer,
    gnss::{self, Fix},
};

use crate::{
    Format, ImportError, Mapping, Note, Summary,
    bag::Bag,
    csv_source::{CsvFiles, CsvSource},
    dataflash,
    force_aligner::ForceAligner,
    row_writer::RowWriter,
    source::{ReceiverFix, Source},
    ulog::Log,
};

/// Plausible range of the mean force, m/s². A mean outside this range indicates that the unit is
/// wrong or that gravity has been removed.
const PLAUSIBLE_MEAN_FORCE_M_S2: std::ops::Range<f64> = 7.0..14.0;

/// Options for reading the input files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Meaning of the columns. Required for CSV and rejected for other formats.
    pub mapping: Option<Mapping>,
    /// Topics to read if several contain the same quantity. Allowed only for bags and MCAP files.
    pub topics: Vec<String>,
}

/// Progress of an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Bytes read so far.
    pub done_bytes: u64,
    /// Bytes to read in total. A file that is read twice counts twice.
    pub total_bytes: u64,
}

/// Converts the files at `paths` into the recording `out`.
///
/// The recording is compressed with gzip if its name ends in `.gz`. Fixes are written to
/// `NAME_gnss.csv` next to it. The files are readable only by their owner and appear only once they
/// are complete.
///
/// # Errors
///
/// Returns an [`ImportError`] if the input is invalid or the output cannot be written. Existing
/// files are then unchanged, with one exception: if the disk becomes full at the very end, the
/// fixes file may already have been written.
pub fn convert(
    paths: &[PathBuf],
    options: &Options,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let format = common_format(paths, options)?;
    let outputs = [out.to_owned(), fixes_path(out)];
    let outputs = outputs.iter().flat_map(|path| [path.clone(), recording::temporary_path(path)]);
    for output in outputs {
        if let Some(path) = paths.iter().find(|path| is_same_file(path, &output)) {
            return Err(ImportError::OutputIsInput { path: path.clone() });
        }
    }
    import(&mut *open_source(format, paths, options)?, &paths[0], out, progress)
}

/// Returns the common format of all files, which must be supported and match the options.
fn common_format(paths: &[PathBuf], options: &Options) -> Result<Format, ImportError> {
    let mut first = None;
    for path in paths {
        let format = match Format::detect(path)? {
            Format::Recording if options.mapping.is_some() => Format::Csv,
            format => format,
        };
        if let Some(remedy) = format.remedy() {
            return Err(ImportError::UnsupportedFormat { path: path.clone(), format, remedy });
        }
        if format != Format::Csv && paths.len() > 1 {
            return Err(ImportError::MultipleFiles { path: path.clone(), format, count: paths.len() });
        }
        if format != Format::Csv && options.mapping.is_some() {
            return Err(ImportError::MappingNotApplicable { path: path.clone(), format });
        }
        if !format.has_topics() && !options.topics.is_empty() {
            return Err(ImportError::TopicsNotApplicable { path: path.clone(), format });
        }
        first = first.or(Some(format));
    }
    first.ok_or(ImportError::NoFiles)
}

fn open_source<'a>(
    format: Format,
    paths: &[PathBuf],
    options: &'a Options,
) -> Result<Box<dyn Source + 'a>, ImportError> {
    let path = &paths[0];
    Ok(match (format, &options.mapping) {
        (Format::Ulog, _) => Box::new(Log::open(path)?),
        (Format::ArduPilot, _) => Box::new(dataflash::Log::open(path)?),
        (Format::Bag | Format::Mcap | Format::Sqlite, _) => Box::new(Bag::open(path, format, &options.topics)?),
        (_, Some(mapping)) => Box::new(CsvSource::open(paths, mapping)?),
        (_, None) => {
            return Err(ImportError::MappingRequired {
                path: path.clone(),
                columns: CsvFiles::open(paths)?.column_names(),
            });
        }
    })
}

fn import(
    source: &mut dyn Source,
    path: &Path,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let mut report = |done_bytes: u64, total_bytes: u64| {
        progress(Progress { done_bytes: done_bytes.min(total_bytes), total_bytes });
    };
    let mut fixes = FixesFile::for_recording(out);
    let total_bytes = source.total_bytes();
    let survey = source.survey(&mut |fix| fixes.write(fix), &mut |done_bytes| report(done_bytes, total_bytes))?;
    let total_bytes = source.total_bytes();
    let source = &*source;
    let layout = Layout { field: survey.has_field, reference: survey.has_reference };
    let mut rows = RowWriter::new(Writer::create(out, layout)?, source.field_samples()?, source.reference_attitudes()?);
    let aligner = source.write_rows(&mut rows, &mut |done_bytes| report(done_bytes, total_bytes))?;
    rows.finish()?;
    report(total_bytes, total_bytes);
    if rows.rows == 0 {
        let without_force = (aligner.rates_without_force > 0)
            .then(|| format!("{} rate samples have no force sample nearby", aligner.rates_without_force).into());
        let reason = survey.reason.or(without_force);
        return Err(ImportError::NoRows { path: path.to_owned(), reason, expected: survey.expected });
    }
    let mut notes = survey.notes;
    let (fixes, fixes_file) = (fixes.count, fixes.finish()?);
    match &fixes_file {
        None => check_no_stale_fixes(out)?,
        Some(fixes) if gnss::path_for(out).is_none() => notes.push(Note::FixesNotDiscoverable { fixes: fixes.clone() }),
        Some(_) => {}
    }
    let summary = Summary { fixes, fixes_file, ..summary(source.format(), &mut rows, &aligner, notes) };
    // The fixes are completed first, so that the recording never appears without them.
    rows.into_writer().finish()?;
    Ok(summary)
}

/// Fixes file, created when the first fix is written.
struct FixesFile {
    path: PathBuf,
    writer: Option<gnss::Writer>,
    count: u64,
}

impl FixesFile {
    fn for_recording(recording: &Path) -> Self {
        Self { path: fixes_path(recording), writer: None, count: 0 }
    }

    fn write(&mut self, fix: &ReceiverFix) -> Result<(), ImportError> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            empty => empty.insert(gnss::Writer::create(&self.path)?),
        };
        let ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m } = *fix;
        let not_nan = |number: f64| Some(number).filter(|number| !number.is_nan());
        let [latitude_deg, longitude_deg, altitude_m] = [latitude_deg, longitude_deg, altitude_m].map(not_nan);
        writer.write(&Fix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })?;
        self.count += 1;
        Ok(())
    }

    /// Completes the file and returns its path; `None` if there were no fixes.
    fn finish(self) -> Result<Option<PathBuf>, ImportError> {
        let Some(writer) = self.writer else { return Ok(None) };
        writer.finish()?;
        Ok(Some(self.path))
    }
}

fn summary(format: Format, rows: &mut RowWriter, aligner: &ForceAligner, mut notes: Vec<Note>) -> Summary {
    let out_of_order = "timestamps do not increase";
    for (what, count, reason) in [
        ("rate samples", aligner.rates_out_of_order, out_of_order),
        ("rate samples", aligner.rates_without_force, "no force sample nearby"),
        ("force samples", aligner.forces_out_of_order, out_of_order),
        ("field samples", rows.fields_out_of_order, out_of_order),
        ("field samples", rows.fields_unmatched, "no row nearby, or another sample is nearer to it"),
        ("reference attitudes", rows.attitudes_out_of_order, out_of_order),
    ] {
        if count > 0 {
            notes.push(Note::Skipped { what, count, reason });
        }
    }
    let mean_force_m_s2 = rows.mean_force_m_s2();
    if !PLAUSIBLE_MEAN_FORCE_M_S2.contains(&mean_force_m_s2) {
        notes.insert(0, Note::ImplausibleForce { mean_force_m_s2 });
    }
    if rows.field_rows == 0 {
        notes.push(Note::Missing { what: "magnetic field: the course is not relative to north" });
    }
    Summary {
        format,
        rows: rows.rows,
        rate_hz: rows.rate_hz(),
        duration_s: rows.duration_s(),
        mean_force_m_s2,
        field_rows: rows.field_rows,
        reference_rows: rows.reference_rows,
        fixes: 0,
        fixes_file: None,
        notes,
    }
}

/// Returns the path of the fixes file.
///
/// This is `NAME_gnss.csv` for both `NAME_imu.csv.gz` and `NAME.csv`. In the second case, the fixes
/// file is not found automatically when the recording is read.
fn fixes_path(out: &Path) -> PathBuf {
    gnss::path_for(out).unwrap_or_else(|| {
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let name = name.strip_suffix(".gz").unwrap_or(&name);
        let name = name.strip_suffix(".csv").unwrap_or(name);
        out.with_file_name(format!("{name}_gnss.csv"))
    })
}

/// Checks that no fixes file of another recording exists next to the new recording, which has no
/// fixes. Those fixes would otherwise be read with the new recording.
fn check_no_stale_fixes(out: &Path) -> Result<(), ImportError> {
    match gnss::find_for(out) {
        Some(fixes) => Err(ImportError::StaleFixes { path: out.to_owned(), fixes }),
        None => Ok(()),
    }
}

/// Returns `true` if both paths name the same file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|found| (found.dev(), found.ino()));
    matches!((identity(a), identity(b)), (Ok(a), Ok(b)) if a == b)
}
