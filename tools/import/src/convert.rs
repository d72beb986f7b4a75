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
    aligned::Aligned,
    error::opening,
    mapped::{self, Files, Groups},
    rows::{Fields, Rows},
    ulog::{Log, Topics},
};

/// Between what is gravity's doing and what is not, m/s².
const GRAVITY_RANGE_M_S2: std::ops::Range<f64> = 7.0..14.0;

/// How files are read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Which column is what; of CSV only, and there it must be given.
    pub mapping: Option<Mapping>,
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
    let written = written.iter().flat_map(|path| [path.clone(), recording::unfinished(path)]);
    for place in written {
        if let Some(path) = paths.iter().find(|path| is_same_file(path, &place)) {
            return Err(ImportError::OutIsSource { path: path.clone() });
        }
    }
    match (format, &options.mapping) {
        (Format::Ulog, _) => ulog(&paths[0], out, progress),
        (_, Some(mapping)) => csv(paths, mapping, out, progress),
        (_, None) => Err(ImportError::MappingNeeded { path: paths[0].clone(), columns: Files::open(paths)?.known() }),
    }
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
        if format == Format::Ulog && paths.len() > 1 {
            return Err(ImportError::NotAlone { path: path.clone(), format, count: paths.len() });
        }
        if format == Format::Ulog && options.mapping.is_some() {
            return Err(ImportError::MappingUnused { path: path.clone(), format });
        }
        first = first.or(Some(format));
    }
    first.ok_or(ImportError::Nothing)
}

fn csv(
    paths: &[PathBuf],
    mapping: &Mapping,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let files = Files::open(paths)?;
    let groups = files.groups(mapping)?;
    let total_bytes = files.read_bytes() + lengths(&groups)?;
    let mut tell = |done_bytes: u64| progress(Progress { done_bytes: done_bytes.min(total_bytes), total_bytes });
    let layout = Layout { field: groups.field.is_some(), reference: false };
    let fields = mapped::fields(&files, &groups, mapping)?;
    let mut rows = Rows::new(Writer::create(out, layout)?, fields, &[]);
    let aligned = mapped::join(&files, &groups, mapping, &mut rows, &mut tell)?;
    rows.finish()?;
    if rows.rows == 0 {
        let reason = (aligned.without_force > 0)
            .then(|| format!("{} of the rate have no force at their time", aligned.without_force));
        let expected = "numbers in the columns of --map, at times of one clock";
        return Err(ImportError::NoRows { path: paths[0].clone(), reason, expected });
    }
    no_old_fixes(out)?;
    let summary = summary(Format::Csv, &mut rows, &aligned, Vec::new());
    rows.into_writer().finish()?;
    Ok(summary)
}

fn ulog(path: &Path, out: &Path, progress: &mut dyn FnMut(Progress)) -> Result<Summary, ImportError> {
    let log = Log::open(path)?;
    let total_bytes = 2 * log.length_bytes();
    let topics = log.topics(&mut |bytes| progress(Progress { done_bytes: bytes, total_bytes }))?;
    if topics.combined == 0 {
        let reason = topics.ending.damage.as_ref().map(|(at_byte, found)| format!("byte {at_byte}: {found}"));
        let expected = "the topic sensor_combined";
        return Err(ImportError::NoRows { path: path.to_owned(), reason, expected });
    }
    let Topics { fields, attitudes, fixes, .. } = &topics;
    let layout = Layout { field: !fields.is_empty(), reference: !attitudes.is_empty() };
    let series: Fields<'_> = Box::new(fields.iter().map(|field| Ok(field.sample())));
    let mut rows = Rows::new(Writer::create(out, layout)?, series, attitudes);
    let mut tell =
        |bytes: u64| progress(Progress { done_bytes: (total_bytes / 2 + bytes).min(total_bytes), total_bytes });
    let aligned = log.rows(topics.combined_instance, &mut rows, &mut tell)?;
    rows.finish()?;
    if rows.rows == 0 {
        let expected = "gyro_rad and accelerometer_m_s2 in sensor_combined";
        return Err(ImportError::NoRows { path: path.to_owned(), reason: None, expected });
    }
    let mut notes = topics.notes(log.length_bytes());
    let mut fixes_file = None;
    if fixes.is_empty() {
        no_old_fixes(out)?;
    } else {
        let place = fixes_path(out);
        let mut writer = gnss::Writer::create(&place)?;
        for fix in fixes {
            let latitude_deg = Some(fix.latitude_deg).filter(|deg| !deg.is_nan());
            let velocity_m_s = fix.velocity_m_s;
            writer.write(&Fix { t_ns: fix.t_ns, velocity_m_s, latitude_deg }, fix.longitude_deg, fix.altitude_m)?;
        }
        // Before the recording: whoever finds that finds its fixes.
        writer.finish()?;
        if gnss::place(out).is_none() {
            notes.push(Note::FixesNotFound { fixes: place.clone() });
        }
        fixes_file = Some(place);
    }
    let mut summary = summary(Format::Ulog, &mut rows, &aligned, notes);
    (summary.fixes, summary.fixes_file) = (fixes.len() as u64, fixes_file);
    rows.into_writer().finish()?;
    Ok(summary)
}

fn summary(format: Format, rows: &mut Rows, aligned: &Aligned, mut notes: Vec<Note>) -> Summary {
    let not_after = "they are not later than the one before them";
    for (what, count, why) in [
        ("samples of the rate", aligned.rates_not_after, not_after),
        ("samples of the rate", aligned.without_force, "there is no force at their time"),
        ("samples of the force", aligned.forces_not_after, not_after),
        ("samples of the field", rows.fields_not_after, not_after),
        ("samples of the field", rows.fields_without_row, "no row is near them, or another one is nearer to it"),
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
    gnss::place(out).unwrap_or_else(|| {
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let name = name.strip_suffix(".gz").unwrap_or(&name);
        let name = name.strip_suffix(".csv").unwrap_or(name);
        out.with_file_name(format!("{name}_gnss.csv"))
    })
}

/// Refuses to lay a recording without fixes beside those of another.
fn no_old_fixes(out: &Path) -> Result<(), ImportError> {
    match gnss::beside(out) {
        Some(fixes) => Err(ImportError::OldFixes { path: out.to_owned(), fixes }),
        None => Ok(()),
    }
}

/// Two names of one file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|found| (found.dev(), found.ino()));
    matches!((identity(a), identity(b)), (Ok(a), Ok(b)) if a == b)
}

/// What is to be read: each group reads its file.
fn lengths(groups: &Groups) -> Result<u64, ImportError> {
    let length = |path: &Path| fs::metadata(path).map(|found| found.len()).map_err(|cause| opening(path, cause));
    groups.paths().map(length).sum()
}
