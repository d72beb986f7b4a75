//! Converts recordings from other systems into a Plumbline recording.

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
    Format, ImportError, Mapping, Note, Options, Summary,
    bag::Bag,
    csv_source::CsvSource,
    dataflash,
    force_aligner::ForceAligner,
    row_writer::{RowWriter, Sample, Samples, is_calm},
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
    timeline::{SegmentChoice, SegmentFinder, Timed, longest},
    tlog::Tlog,
    ulog::Log,
};

/// Number of samples between two progress reports.
const PROGRESS_INTERVAL_SAMPLES: u64 = 1024;

/// Plausible range of the mean force, m/s². A mean outside this range indicates that the unit is
/// wrong or that gravity has been removed.
const PLAUSIBLE_MEAN_FORCE_M_S2: std::ops::Range<f64> = 7.0..14.0;

/// Plausible range of the mean magnetic field, µT. The Earth's field is 22 to 67 µT. Iron in the
/// vehicle can cancel two thirds of this field or add three times as much.
const PLAUSIBLE_MEAN_FIELD_UT: std::ops::Range<f64> = 8.0..240.0;

/// Minimum number of magnetometer samples for a check of their magnitude. Fewer samples may all be
/// disturbed.
const MIN_FIELD_SAMPLES: u64 = 50;

/// Remedy for text in which the times never increase.
const CONSTANT_TEXT_TIMES: &str = "map another column with --map, or state the rate and read the text as a stream, as with `plumb up --source 'stdin?rate_hz=100' < FILE`";
/// Remedy for a log in which the times never increase.
const CONSTANT_LOG_TIMES: &str = "set the clock of the program that writes the log";

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
/// `NAME_gnss.csv` next to the recording. The files are readable only by their owner and appear
/// only once they are complete.
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
    import(&mut *open_source(format, paths, options)?, &paths[0], options.segment, out, progress)
}

/// Recording that can be read without an import.
#[derive(Debug, Clone, PartialEq)]
pub struct PlainRecording {
    /// Times of the first and the last row, ns.
    pub range_ns: [i64; 2],
    /// Note on a last row that may be incomplete.
    pub note: Option<Note>,
}

impl PlainRecording {
    /// Reads a recording. Returns `None` if it needs an import, because a row is invalid, or its
    /// clock wraps or starts again.
    pub fn read(path: &Path) -> Option<Self> {
        let mut finder = SegmentFinder::default();
        let mut rows = recording::Reader::open(path).ok()?;
        for row in &mut rows {
            finder.push(row.ok()?.t_ns);
        }
        match finder.segments() {
            [segment] if finder.wraps == 0 => Some(Self {
                range_ns: [segment.first_ns, segment.last_ns],
                note: rows.unended_line().map(|line| Note::UnendedRow { line }),
            }),
            _ => None,
        }
    }
}

/// Returns notes if the last fix of the file may be incomplete, and if no fix is within the times
/// of the rows.
///
/// # Errors
///
/// Returns an error if the fixes cannot be read.
pub fn fixes_notes(fixes: &Path, rows_ns: [i64; 2]) -> Result<Vec<Note>, ImportError> {
    let survey = gnss::survey(fixes)?;
    let unended = survey.unended_line.map(|line| Note::UnendedRow { line });
    Ok(unended.into_iter().chain(outside("fixes", survey.range_ns, rows_ns)).collect())
}

fn outside(what: &'static str, series_ns: [i64; 2], rows_ns: [i64; 2]) -> Option<Note> {
    let is_outside = series_ns[1] < rows_ns[0] || series_ns[0] > rows_ns[1];
    is_outside.then_some(Note::NoOverlap { what, series_ns, rows_ns })
}

/// Returns a note if no sample of a series is within the time range of the rows.
fn outside_rows<T: Timed>(
    what: &'static str,
    samples: Samples<'_, T>,
    rows_ns: [i64; 2],
) -> Result<Option<Note>, ImportError> {
    let mut series_ns: Option<[i64; 2]> = None;
    for sample in samples {
        let t_ns = sample?.t_ns();
        let [first_ns, last_ns] = series_ns.unwrap_or([t_ns; 2]);
        series_ns = Some([first_ns.min(t_ns), last_ns.max(t_ns)]);
    }
    Ok(series_ns.and_then(|series_ns| outside(what, series_ns, rows_ns)))
}

/// Returns the format that all files have in common. It must be supported and match the options.
fn common_format(paths: &[PathBuf], options: &Options) -> Result<Format, ImportError> {
    let mut first = None;
    for path in paths {
        let format = Format::detect(path)?;
        if let Some(remedy) = format.remedy() {
            let remedy = remedy
                .replace("FILE", &foreign::shell_word(&path.to_string_lossy()))
                .replace("FOLDER", &folder_name(path));
            return Err(ImportError::UnsupportedFormat { path: path.clone(), format, remedy: remedy.into() });
        }
        if !format.is_text() && paths.len() > 1 {
            return Err(ImportError::MultipleFiles { path: path.clone(), format, count: paths.len() });
        }
        // Units and axes also apply to the messages of a bag.
        let mapping = options.mapping.as_ref().filter(|mapping| mapping.is_explicit() || !format.has_topics());
        if !format.is_text() && mapping.is_some() {
            return Err(ImportError::MappingNotApplicable { path: path.clone(), format });
        }
        let numbers = [("--imu", options.imu), ("--mag", options.mag), ("--gnss", options.gnss)];
        let is_numbered = |what: &str| !(format.is_text() || format == Format::Tlog && what != "--imu");
        if let Some((what, found)) =
            numbers.into_iter().find_map(|(what, number)| Some((what, number.filter(|_| !is_numbered(what))?)))
        {
            return Err(ImportError::UnknownSensor { path: path.clone(), what, found, count: 0 });
        }
        if !format.has_topics() && !options.topics.is_empty() {
            return Err(ImportError::TopicsNotApplicable { path: path.clone(), format });
        }
        first = first.or(Some(format));
    }
    first.ok_or(ImportError::NoFiles)
}

/// Returns the name of a folder for converted data, quoted for the shell.
///
/// For a file, this is its name without the extension; for a folder, its unchanged name.
fn folder_name(path: &Path) -> String {
    let folder = if path.is_dir() { path.to_owned() } else { path.with_extension("") };
    foreign::shell_word(&folder.to_string_lossy())
}

fn open_source<'a>(
    format: Format,
    paths: &[PathBuf],
    options: &'a Options,
) -> Result<Box<dyn Source + 'a>, ImportError> {
    let path = &paths[0];
    Ok(match (format, &options.mapping) {
        (Format::Ulog, _) => Box::new(Log::open(path, options)?),
        (Format::ArduPilot, _) => Box::new(dataflash::Log::open(path, options)?),
        (Format::Tlog, _) => Box::new(Tlog::open(path, options)?),
        (Format::Bag | Format::Mcap | Format::Sqlite, _) => Box::new(Bag::open(path, format, options)?),
        (_, mapping) => {
            let mapping = mapping.clone().unwrap_or_default();
            let format = common_text_format(format, &mapping);
            Box::new(CsvSource::open(paths, mapping, options.time_bits, format)?)
        }
    })
}

/// Returns the format of a text file. With an explicit mapping, the format is always CSV.
fn common_text_format(format: Format, mapping: &Mapping) -> Format {
    if mapping.is_explicit() { Format::Csv } else { format }
}

fn import(
    source: &mut dyn Source,
    path: &Path,
    segment: Option<usize>,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, ImportError> {
    let mut report = |done_bytes: u64, total_bytes: u64| {
        progress(Progress { done_bytes: done_bytes.min(total_bytes), total_bytes });
    };
    let total_bytes = source.total_bytes();
    let survey = source.survey(&mut |done_bytes| report(done_bytes, total_bytes))?;
    let total_bytes = source.total_bytes();
    let source = &*source;
    let choice = choose_segment(path, segment, &survey)?;
    let layout = Layout { field: survey.has_field, reference: survey.has_reference };
    let fields = choice.others(source.field_samples()?);
    let attitudes = choice.others(source.reference_attitudes()?);
    let interpolates_slow = is_calm(choice.others(source.reference_attitudes()?))?;
    let mut rows = RowWriter::new(Writer::create(out, layout)?, fields, attitudes, interpolates_slow);
    let mut aligner = ForceAligner::default();
    let mut count = 0;
    let mut push = |motion: Inertial, rows: &mut RowWriter<'_>| {
        if count % PROGRESS_INTERVAL_SAMPLES == 0 {
            report(source.read_bytes(), total_bytes);
        }
        count += 1;
        motion.force.map_or(Ok(()), |force| aligner.push_force(force, rows))?;
        motion.rate.map_or(Ok(()), |rate| aligner.push_rate(rate, rows))
    };
    match source.motion()? {
        Motion::Joint(samples) => {
            for motion in choice.rows(samples) {
                push(motion?, &mut rows)?;
            }
        }
        Motion::Separate { rates, forces } => {
            for motion in merged(choice.rows(rates), choice.others(forces)) {
                push(motion?, &mut rows)?;
            }
        }
    }
    aligner.finish(&mut rows)?;
    rows.finish()?;
    if rows.rows == 0 {
        let missing = aligner.rates_without_force;
        let reason = (missing > 0).then(|| format!("{missing} rate samples have no force sample nearby").into());
        return Err(ImportError::NoRows {
            path: path.to_owned(),
            reason: survey.reason.or(reason),
            expected: survey.expected,
        });
    }
    if rows.rows == 1 && aligner.rates_out_of_order > 0 {
        let remedy = if source.format().is_text() { CONSTANT_TEXT_TIMES } else { CONSTANT_LOG_TIMES };
        let rows = rows.rows + aligner.rates_out_of_order;
        return Err(ImportError::ConstantTimes { path: path.to_owned(), rows, remedy });
    }
    let mut notes = survey.notes.clone();
    notes.extend(field_note(&rows, source.field_factor()));
    if choice.segments.len() > 1 {
        notes.insert(
            0,
            Note::Segments {
                read: choice.index + 1,
                is_requested: segment.is_some(),
                segments: choice.segments.clone(),
            },
        );
    }
    if survey.wraps > 0 {
        notes.insert(0, Note::Wrapped { count: survey.wraps });
    }
    if survey.has_field && rows.field_rows == 0 {
        notes.extend(outside_rows("field samples", choice.others(source.field_samples()?), rows.range_ns())?);
    }
    if survey.has_reference && rows.reference_rows == 0 {
        let attitudes = choice.others(source.reference_attitudes()?);
        notes.extend(outside_rows("reference attitudes", attitudes, rows.range_ns())?);
    }
    let mut fixes = FixesFile::for_recording(out);
    if survey.has_fixes {
        for fix in choice.others(source.fixes()?) {
            fixes.write(&fix?)?;
        }
    }
    report(total_bytes, total_bytes);
    notes.extend(fixes.notes(rows.range_ns()));
    let fixes_count = fixes.count;
    let fixes_file = fixes.finish()?;
    match &fixes_file {
        None => check_no_stale_fixes(out)?,
        Some(fixes) if gnss::path_for(out).as_ref() != Some(fixes) => {
            notes.push(Note::FixesNotDiscoverable { fixes: fixes.clone() });
        }
        Some(_) => {}
    }
    // Rows of other segments count as unused only if the user did not choose a segment.
    let counts_segment = |index: &usize| segment.is_none() || *index == choice.index;
    let counted = (0..choice.segments.len()).filter(counts_segment).filter_map(|index| choice.segments.get(index));
    let surveyed_rows = counted.map(|segment| segment.samples).sum::<u64>();
    let source_rows = surveyed_rows.max(rows.rows) + survey.unreadable_rows;
    let summary = Summary {
        fixes: fixes_count,
        fixes_file,
        source_rows,
        segments: choice.segments,
        sensors: survey.sensors,
        ..summary(source.format(), &mut rows, &aligner, notes)
    };
    // The fixes file is completed first, so that the recording never appears without its fixes.
    rows.into_writer().finish()?;
    Ok(summary)
}

/// Returns the segment to read, by default the longest one.
fn choose_segment(path: &Path, segment: Option<usize>, survey: &Survey) -> Result<SegmentChoice, ImportError> {
    let segments = survey.segments.clone();
    let index = match segment {
        None => longest(&segments),
        Some(number) if (1..=segments.len().max(1)).contains(&number) => number - 1,
        Some(found) => {
            return Err(ImportError::UnknownSegment { path: path.to_owned(), found, count: segments.len().max(1) });
        }
    };
    Ok(SegmentChoice { clock: survey.clock.clone(), segments, index })
}

/// Merges the samples of two series in the order of time.
fn merged<'a>(rates: Samples<'a, Sample>, forces: Samples<'a, Sample>) -> Samples<'a, Inertial> {
    let (mut rates, mut forces) = (rates.peekable(), forces.peekable());
    Box::new(std::iter::from_fn(move || {
        let is_rate_first = match (rates.peek(), forces.peek()) {
            (Some(Ok((rate_ns, _))), Some(Ok((force_ns, _)))) => rate_ns < force_ns,
            (Some(_), Some(Ok(_)) | None) => true,
            (_, Some(_)) => false,
            (None, None) => return None,
        };
        let rate = |sample| Inertial { rate: Some(sample), force: None };
        let force = |sample| Inertial { rate: None, force: Some(sample) };
        if is_rate_first {
            rates.next().map(|sample| sample.map(rate))
        } else {
            forces.next().map(|sample| sample.map(force))
        }
    }))
}

/// Fixes file, created when the first fix is written.
struct FixesFile {
    path: PathBuf,
    writer: Option<gnss::Writer>,
    count: u64,
    /// First and last time, ns.
    range_ns: Option<[i64; 2]>,
    /// Number of fixes with non-increasing timestamps.
    out_of_order: u64,
}

impl FixesFile {
    fn for_recording(recording: &Path) -> Self {
        Self { path: fixes_path(recording), writer: None, count: 0, range_ns: None, out_of_order: 0 }
    }

    /// Writes the fix if its timestamp increases.
    fn write(&mut self, fix: &ReceiverFix) -> Result<(), ImportError> {
        if self.range_ns.is_some_and(|[_, last_ns]| fix.t_ns <= last_ns) {
            self.out_of_order += 1;
            return Ok(());
        }
        let first_ns = self.range_ns.map_or(fix.t_ns, |[first_ns, _]| first_ns);
        self.range_ns = Some([first_ns, fix.t_ns]);
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

    /// Returns notes on unused fixes. `rows_ns` is the time range of the rows.
    fn notes(&self, rows_ns: [i64; 2]) -> Vec<Note> {
        let mut notes = Vec::new();
        if self.out_of_order > 0 {
            let reason = "timestamps do not increase";
            notes.push(Note::Skipped { what: "fixes", count: self.out_of_order, reason });
        }
        notes.extend(self.range_ns.and_then(|series_ns| outside("fixes", series_ns, rows_ns)));
        notes
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
        source_rows: rows.rows,
        segments: Vec::new(),
        sensors: Vec::new(),
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

/// Returns a note if the magnetometer is dead or the unit of its samples is wrong.
///
/// `factor` converts the numbers of the source to µT; `None` if `--units` does not apply to them.
fn field_note(rows: &RowWriter<'_>, factor: Option<f64>) -> Option<Note> {
    if rows.is_field_constant() {
        return Some(Note::ConstantField { count: rows.field_rows });
    }
    let mean_field_ut = rows.mean_field_ut();
    let is_implausible = rows.field_rows >= MIN_FIELD_SAMPLES && !PLAUSIBLE_MEAN_FIELD_UT.contains(&mean_field_ut);
    let unit = || factor.and_then(|factor| mapping::unit_of_earth_field(mean_field_ut / factor));
    is_implausible.then(|| Note::ImplausibleField { mean_field_ut, unit: unit() })
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

/// Checks that no fixes file exists next to a new recording without fixes.
///
/// A fixes file of another recording would otherwise be read with the new recording.
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
