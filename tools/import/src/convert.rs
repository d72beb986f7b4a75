//! Files in, a recording out.

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
    force_aligner::ForceAligner,
    bag::Bag,
    dataflash,
    csv_source::{Files, Table},
    row_writer::RowWriter,
    source::{Fixed, Source},
    ulog::Log,
};

/// Between what is gravity's doing and what is not, m/s².
const GRAVITY_RANGE_M_S2: std::ops::Range<f64> = 7.0..14.0;

/// How files are read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Which column is what; of CSV only, and there it must be given.
    pub mapping: Option<Mapping>,
    /// Which topics to read where there are several of a kind; of a bag or an MCAP file only.
    pub topics: Vec<String>,
}

/// How far an import is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Read so far, bytes.
    pub done_bytes: u64,
    /// To be read in all, bytes: a file that is read twice counts twice.
    pub total_bytes: u64,
}

/// Makes the recording `out` of the files at `paths`, gzip where its name ends in `.gz`, and `NAME_gnss.csv` beside it where there are
/// fixes. Both are this user's alone, and in place once they are whole. Fails without having changed anything; only a disk that is
/// full at the very end may leave the fixes alone.
pub fn convert(
    paths: &[PathBuf],
    options: &Options,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let format = format_of(paths, options)?;
    let written = [out.to_owned(), fixes_path(out)];
    let written = written.iter().flat_map(|path| [path.clone(), recording::temporary_path(path)]);
    for place in written {
        if let Some(path) = paths.iter().find(|path| is_same_file(path, &place)) {
            return Err(ImportError::OutIsSource { path: path.clone() });
        }
    }
    import(&mut *source(format, paths, options)?, &paths[0], out, progress)
}

/// The one format of all files, which is read.
fn format_of(paths: &[PathBuf], options: &Options) -> Result<Format, ImportError> {
    let mut first = None;
    for path in paths {
        let format = match Format::of(path)? {
            Format::Recording if options.mapping.is_some() => Format::Csv,
            format => format,
        };
        if let Some(remedy) = format.remedy() {
            return Err(ImportError::Unread { path: path.clone(), format, remedy });
        }
        if format != Format::Csv && paths.len() > 1 {
            return Err(ImportError::NotAlone { path: path.clone(), format, count: paths.len() });
        }
        if format != Format::Csv && options.mapping.is_some() {
            return Err(ImportError::MappingUnused { path: path.clone(), format });
        }
        if !format.has_topics() && !options.topics.is_empty() {
            return Err(ImportError::TopicsUnused { path: path.clone(), format });
        }
        first = first.or(Some(format));
    }
    first.ok_or(ImportError::Nothing)
}

fn source<'a>(format: Format, paths: &[PathBuf], options: &'a Options) -> Result<Box<dyn Source + 'a>, ImportError> {
    let path = &paths[0];
    Ok(match (format, &options.mapping) {
        (Format::Ulog, _) => Box::new(Log::open(path)?),
        (Format::ArduPilot, _) => Box::new(dataflash::Log::open(path)?),
        (Format::Bag | Format::Mcap | Format::Sqlite, _) => Box::new(Bag::open(path, format, &options.topics)?),
        (_, Some(mapping)) => Box::new(Table::open(paths, mapping)?),
        (_, None) => {
            return Err(ImportError::MappingNeeded { path: path.clone(), columns: Files::open(paths)?.known() });
        }
    })
}

fn import(
    source: &mut dyn Source,
    path: &Path,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let mut tell = |done_bytes: u64, total_bytes: u64| {
        progress(Progress { done_bytes: done_bytes.min(total_bytes), total_bytes });
    };
    let mut fixes = FixesFile::beside(out);
    let total_bytes = source.total_bytes();
    let survey = source.survey(&mut |fix| fixes.write(fix), &mut |done_bytes| tell(done_bytes, total_bytes))?;
    let total_bytes = source.total_bytes();
    let source = &*source;
    let layout = Layout { field: survey.has_field, reference: survey.has_reference };
    let mut rows = RowWriter::new(Writer::create(out, layout)?, source.fields()?, source.attitudes()?);
    let aligned = source.rows(&mut rows, &mut |done_bytes| tell(done_bytes, total_bytes))?;
    rows.finish()?;
    tell(total_bytes, total_bytes);
    if rows.rows == 0 {
        let without_force = (aligned.rates_without_force > 0)
            .then(|| format!("{} of the rate have no force at their time", aligned.rates_without_force));
        let reason = survey.reason.or(without_force);
        return Err(ImportError::NoRows { path: path.to_owned(), reason, expected: survey.expected });
    }
    let mut notes = survey.notes;
    let (fixes, fixes_file) = (fixes.count, fixes.finish()?);
    match &fixes_file {
        None => no_old_fixes(out)?,
        Some(fixes) if gnss::path_for(out).is_none() => notes.push(Note::FixesNotFound { fixes: fixes.clone() }),
        Some(_) => {}
    }
    let summary = Summary { fixes, fixes_file, ..summary(source.format(), &mut rows, &aligned, notes) };
    // After the fixes: whoever finds the recording finds them.
    rows.into_writer().finish()?;
    Ok(summary)
}

/// The file of fixes, which is there where there are any.
struct FixesFile {
    path: PathBuf,
    writer: Option<gnss::Writer>,
    count: u64,
}

impl FixesFile {
    fn beside(recording: &Path) -> Self {
        Self { path: fixes_path(recording), writer: None, count: 0 }
    }

    fn write(&mut self, fix: &Fixed) -> Result<(), ImportError> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            none => none.insert(gnss::Writer::create(&self.path)?),
        };
        let Fixed { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m } = *fix;
        let told = |number: f64| Some(number).filter(|number| !number.is_nan());
        let [latitude_deg, longitude_deg, altitude_m] = [latitude_deg, longitude_deg, altitude_m].map(told);
        writer.write(&Fix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })?;
        self.count += 1;
        Ok(())
    }

    /// Puts the file in its place; `None` where there was no fix.
    fn finish(self) -> Result<Option<PathBuf>, ImportError> {
        let Some(writer) = self.writer else { return Ok(None) };
        writer.finish()?;
        Ok(Some(self.path))
    }
}

fn summary(format: Format, rows: &mut RowWriter, aligned: &ForceAligner, mut notes: Vec<Note>) -> Summary {
    let not_after = "they are not later than the one before them";
    for (what, count, why) in [
        ("samples of the rate", aligned.rates_out_of_order, not_after),
        ("samples of the rate", aligned.rates_without_force, "there is no force at their time"),
        ("samples of the force", aligned.forces_out_of_order, not_after),
        ("samples of the field", rows.fields_not_after, not_after),
        ("samples of the field", rows.fields_without_row, "no row is near them, or another one is nearer to it"),
        ("reference attitudes", rows.attitudes_not_after, not_after),
    ] {
        if count > 0 {
            notes.push(Note::LeftOut { what, count, why });
        }
    }
    let mean_force_m_s2 = rows.mean_force_m_s2();
    if !GRAVITY_RANGE_M_S2.contains(&mean_force_m_s2) {
        notes.insert(0, Note::NotGravity { mean_force_m_s2 });
    }
    if rows.field_rows == 0 {
        notes.push(Note::Missing { what: "magnetic field: the course has no north" });
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

/// `NAME_gnss.csv` beside `NAME_imu.csv.gz`, and beside `NAME.csv` too, though nobody looks for it there.
fn fixes_path(out: &Path) -> PathBuf {
    gnss::path_for(out).unwrap_or_else(|| {
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let name = name.strip_suffix(".gz").unwrap_or(&name);
        let name = name.strip_suffix(".csv").unwrap_or(name);
        out.with_file_name(format!("{name}_gnss.csv"))
    })
}

/// Refuses to lay a recording without fixes beside those of another.
fn no_old_fixes(out: &Path) -> Result<(), ImportError> {
    match gnss::find_for(out) {
        Some(fixes) => Err(ImportError::OldFixes { path: out.to_owned(), fixes }),
        None => Ok(()),
    }
}

/// Two names of one file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|found| (found.dev(), found.ino()));
    matches!((identity(a), identity(b)), (Ok(a), Ok(b)) if a == b)
}
