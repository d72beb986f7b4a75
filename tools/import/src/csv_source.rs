//! Source that joins mapped columns of CSV files by time.
//!
//! Input: CSV files and a mapping.
//!
//! Output: rows at the times of the rate samples.
//!
//! Time: each file has its own time column. All files share one clock.
//!
//! Failure: a missing column is an error, and so is a file without a valid row. Single malformed
//! rows are skipped and counted.

use std::{
    cell::Cell,
    fs, iter,
    path::{Path, PathBuf},
    rc::Rc,
};

use foreign::ForeignText;
use mapping::{
    FIELD, FORCE, POSITION, RATE, REFERENCE, SCORED,
    names::nearest,
    text::{DAY_NS, Time, without_unit},
};
use recording::{RecordingError, Reference};

use crate::{
    Format, ImportError, Mapping, Note,
    csv_reader::{CsvReader, CsvRecord, RowCounts},
    error::open_error,
    row_writer::Sample,
    row_writer::{Attitude, Samples},
    source::{Inertial, Motion, ReceiverFix, Source, Survey},
    timeline::{SegmentFinder, SourceClock},
};

/// Number of rows between two progress reports.
const PROGRESS_INTERVAL_ROWS: u64 = 1024;
/// Names of the columns that every recording has.
const RECORDING_COLUMNS: [&str; 7] = ["t_s", "gx", "gy", "gz", "ax", "ay", "az"];

/// CSV files with a mapping of their columns.
pub(crate) struct CsvSource {
    files: CsvFiles,
    groups: ColumnGroups,
    mapping: Mapping,
    /// Units adopted from the column names, except default ones.
    header_units: Vec<&'static str>,
    time_bits: Option<u8>,
    format: Format,
    length_bytes: u64,
}

impl CsvSource {
    /// Opens the files, reads their headers and resolves the mapping.
    ///
    /// `time_bits` is the width of the time in bits if the time is a wrapping counter.
    pub(crate) fn open(
        paths: &[PathBuf],
        mapping: Mapping,
        time_bits: Option<u8>,
        format: Format,
    ) -> Result<Self, ImportError> {
        let files = CsvFiles::open(paths)?;
        let groups = files.column_groups(&mapping)?;
        let (mapping, header_units) = files.with_header_units(&mapping, &groups)?;
        let length = |path: &Path| fs::metadata(path).map(|found| found.len()).map_err(|cause| open_error(path, cause));
        let surveyed = groups.files().into_iter().map(length).sum::<Result<u64, _>>()?;
        let length_bytes = files.read_bytes() + surveyed + groups.paths().map(length).sum::<Result<u64, _>>()?;
        Ok(Self { files, groups, mapping, header_units, time_bits, format, length_bytes })
    }

    /// Reads all rows of a file and checks the mapped columns.
    fn check_file(
        &self,
        path: &Path,
        survey: &mut Survey,
        finder: &mut Option<SegmentFinder>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ImportError> {
        let is_rate_file = self.groups.rate.path == path;
        let mut reader = CsvReader::open(path, &self.files.read_bytes)?;
        let mut counts = RowCounts::default();
        for count in 0u64.. {
            if count.is_multiple_of(PROGRESS_INTERVAL_ROWS) {
                progress(self.files.read_bytes());
            }
            let checked = match reader.next() {
                Ok(None) => break,
                Ok(Some(record)) => self.check_row(path, &record),
                Err(error @ ImportError::Malformed { .. }) => Err(error),
                Err(error) => return Err(error),
            };
            match checked {
                Ok((time, has_rate)) => {
                    counts.add_valid();
                    if let (Some(time), true, true) = (time, is_rate_file, has_rate) {
                        let period_ns = || match (time, self.time_bits) {
                            (Time::OfDay(_), _) => Some(DAY_NS),
                            (_, Some(bits)) => {
                                self.mapping.wrap_period_ns(bits.into()).and_then(|ns| i64::try_from(ns).ok())
                            }
                            _ => None,
                        };
                        let new_finder = || SegmentFinder::new(&SourceClock { period_ns: period_ns() });
                        let finder = finder.get_or_insert_with(new_finder);
                        finder.push(time.ns());
                    }
                }
                Err(error) => counts.add_malformed(error),
            }
        }
        progress(self.files.read_bytes());
        survey.unreadable_rows += if is_rate_file { counts.malformed } else { 0 };
        survey.notes.extend(reader.into_notes(counts)?);
        Ok(())
    }

    /// Checks the mapped columns of a row. Returns its time, and `true` if it has a rate.
    fn check_row(&self, path: &Path, record: &CsvRecord<'_>) -> Result<(Option<Time>, bool), ImportError> {
        let groups = &self.groups;
        let mut time_column = None;
        let mut has_rate = false;
        let vectors = [Some(&groups.rate), Some(&groups.force), groups.field.as_ref()];
        let velocity = groups.velocity.as_ref().map(|(_, group)| group);
        for (index, group) in vectors.into_iter().chain([velocity]).enumerate() {
            if let Some(group) = group.filter(|group| group.path == path) {
                let numbers = record.numbers(group.indices)?;
                has_rate |= index == 0 && numbers.is_some();
                time_column = Some(group.time);
            }
        }
        if let Some(group) = groups.reference.as_ref().filter(|group| group.path == path) {
            record.numbers(group.indices)?;
            time_column = Some(group.time);
        }
        if let Some((_, index)) = groups.scored.as_ref().filter(|(scored, _)| scored == path) {
            record.flag(*index)?;
        }
        let time = time_column.map(|column| record.time(column, self.mapping.time_digits())).transpose()?;
        Ok((time, has_rate))
    }
}

impl Source for CsvSource {
    fn format(&self) -> Format {
        self.format
    }

    /// Returns the number of bytes to read. The headers are read first, then each file once for the
    /// survey, then the file of each column group once.
    fn total_bytes(&self) -> u64 {
        self.length_bytes
    }

    fn read_bytes(&self) -> u64 {
        self.files.read_bytes()
    }

    fn survey(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let ColumnGroups { field, reference, velocity, .. } = &self.groups;
        let mut survey = Survey {
            has_field: field.is_some(),
            has_reference: reference.is_some(),
            has_fixes: velocity.is_some(),
            expected: "numbers in the mapped columns, with times of one clock".into(),
            ..Survey::default()
        };
        if !self.header_units.is_empty() {
            survey.notes.push(Note::HeaderUnits { units: self.header_units.clone() });
        }
        let mut finder = None;
        for path in self.groups.files() {
            self.check_file(path, &mut survey, &mut finder, progress)?;
        }
        if let Some(finder) = finder {
            survey.clock = finder.clock();
            survey.segments = finder.segments().to_vec();
            survey.wraps = finder.wraps;
        }
        Ok(survey)
    }

    fn field_factor(&self) -> Option<f64> {
        Some(self.mapping.units().field.unwrap_or(1.0))
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(group) = &self.groups.field else { return Ok(Box::new(iter::empty())) };
        let mapping = &self.mapping;
        self.files.samples(group, mapping.time_digits(), move |_, t_ns, found| Some((t_ns, mapping.field_ut(found))))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some(group) = &self.groups.reference else { return Ok(Box::new(iter::empty())) };
        let mapping = &self.mapping;
        let scored = self.groups.scored.as_ref().filter(|(path, _)| *path == group.path).map(|(_, index)| *index);
        self.files.samples(group, mapping.time_digits(), move |record, t_ns, found| {
            let scored = scored.is_none_or(|index| record.flag(index).unwrap_or(false));
            let reference = Reference { quaternion: mapping.reference(found)?, scored };
            Some(Attitude { t_ns, reference, reset_counter: Some(0) })
        })
    }

    fn fixes(&self) -> Result<Samples<'_, ReceiverFix>, ImportError> {
        let Some((position, group)) = &self.groups.velocity else { return Ok(Box::new(iter::empty())) };
        let (mapping, position) = (&self.mapping, *position);
        // If one file contains both rates and fixes, several rows repeat the same fix. It is passed
        // on only once.
        let is_repeated = group.path == self.groups.rate.path;
        let mut last = None;
        self.files.samples(group, mapping.time_digits(), move |record, t_ns, velocity| {
            let number = |index| record.numbers([index]).ok().flatten().map_or(f64::NAN, |[number]| number);
            let location = position.map(|index| index.map_or(f64::NAN, number));
            let values = (velocity.map(f64::to_bits), location.map(f64::to_bits));
            if is_repeated && last.replace(values) == Some(values) {
                return None;
            }
            let [latitude_deg, longitude_deg, altitude_m] = location;
            let velocity_m_s = mapping.velocity_m_s(velocity);
            Some(ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })
        })
    }

    fn motion(&self) -> Result<Motion<'_>, ImportError> {
        let (digits, mapping, groups) = (self.mapping.time_digits(), &self.mapping, &self.groups);
        if groups.rate.path == groups.force.path {
            let force = groups.force.indices;
            // A row may contain only a rate or only a force.
            return Ok(Motion::Joint(self.files.rows(&groups.rate.path, groups.rate.time, digits, {
                let rate = groups.rate.indices;
                move |record, t_ns| {
                    let vector = |indices| record.numbers(indices).ok().flatten();
                    let rate = vector(rate).map(|found| (t_ns, mapping.rate_rad_s(found)));
                    let force = vector(force).map(|found| (t_ns, mapping.force_m_s2(found)));
                    (rate.is_some() || force.is_some()).then_some(Inertial { rate, force })
                }
            })?));
        }
        Ok(Motion::Separate {
            rates: self
                .files
                .samples(&groups.rate, digits, |_, t_ns, found| Some((t_ns, mapping.rate_rad_s(found))))?,
            forces: self
                .files
                .samples(&groups.force, digits, |_, t_ns, found| Some((t_ns, mapping.force_m_s2(found))))?,
        })
    }
}

/// CSV files and their column names.
pub(crate) struct CsvFiles {
    columns: Vec<(PathBuf, Vec<ForeignText>)>,
    read_bytes: Rc<Cell<u64>>,
}

/// Columns of one vector, the file that contains them, and the time column of that file.
struct ColumnGroup<const N: usize> {
    path: PathBuf,
    time: usize,
    indices: [usize; N],
}

/// Columns of all mapped quantities.
struct ColumnGroups {
    rate: ColumnGroup<3>,
    force: ColumnGroup<3>,
    field: Option<ColumnGroup<3>>,
    reference: Option<ColumnGroup<4>>,
    /// Position columns, and the velocity columns in the same file.
    velocity: Option<([Option<usize>; 3], ColumnGroup<3>)>,
    /// File and index of the column that contains 1 in scored rows.
    scored: Option<(PathBuf, usize)>,
}

impl ColumnGroups {
    /// Returns the file and the index of each column that is mapped to `target`: a time, or a
    /// component of rate, force or magnetic field.
    fn columns(&self, target: &str) -> Vec<(&Path, usize)> {
        let vectors = [(RATE, Some(&self.rate)), (FORCE, Some(&self.force)), (FIELD, self.field.as_ref())];
        let vectors = vectors.into_iter().filter_map(|(targets, group)| Some((targets, group?)));
        let columns = vectors.flat_map(|(targets, group)| {
            let parts = targets.into_iter().zip(group.indices).chain([("t", group.time)]);
            parts.map(|(of, index)| (of, group.path.as_path(), index))
        });
        columns.filter(|(of, ..)| *of == target).map(|(_, path, index)| (path, index)).collect()
    }

    /// Returns the path of the file of each column group.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        let velocity = self.velocity.iter().map(|(_, group)| group);
        let vectors = [&self.rate, &self.force].into_iter().chain(&self.field).chain(velocity);
        vectors.map(|group| &group.path).chain(self.reference.iter().map(|group| &group.path)).map(PathBuf::as_path)
    }

    /// Returns the path of each file that is read.
    fn files(&self) -> Vec<&Path> {
        let mut files: Vec<&Path> = Vec::new();
        for path in self.paths() {
            if !files.contains(&path) {
                files.push(path);
            }
        }
        files
    }
}

impl CsvFiles {
    /// Opens the files and reads their headers.
    pub(crate) fn open(paths: &[PathBuf]) -> Result<Self, ImportError> {
        let read_bytes = Rc::new(Cell::new(0));
        let columns = paths.iter().map(|path| Ok((path.clone(), CsvReader::open(path, &read_bytes)?.names)));
        Ok(Self { columns: columns.collect::<Result<_, ImportError>>()?, read_bytes })
    }

    /// Returns the names of all columns, with duplicates removed.
    pub(crate) fn column_names(&self) -> Vec<ForeignText> {
        let mut known: Vec<ForeignText> = Vec::new();
        for name in self.columns.iter().flat_map(|(_, names)| names) {
            if !known.contains(name) {
                known.push(name.clone());
            }
        }
        known
    }

    /// Returns the number of bytes read so far.
    fn read_bytes(&self) -> u64 {
        self.read_bytes.get()
    }

    /// Returns the mapping with the units that the column names contain, and the names of those
    /// units that are not the default.
    fn with_header_units(
        &self,
        mapping: &Mapping,
        groups: &ColumnGroups,
    ) -> Result<(Mapping, Vec<&'static str>), ImportError> {
        let name = |path: &Path, index: usize| {
            let (_, names) = self.columns.iter().find(|(other, _)| other == path)?;
            names.get(index).map(ForeignText::raw)
        };
        let names_of = |target: &'static str| {
            groups.columns(target).into_iter().filter_map(|(path, index)| name(path, index)).collect()
        };
        // Dates and times of day have no unit.
        let mut reader = CsvReader::open(&groups.rate.path, &self.read_bytes)?;
        let has_clock = reader.next().ok().flatten().is_some_and(|record| record.has_clock_time(groups.rate.time));
        let needs_time_unit = !has_clock;
        mapping.with_header_units(names_of, needs_time_unit).map_err(|error| {
            let path = groups.rate.path.clone();
            ImportError::HeaderUnits { path, error: error.into() }
        })
    }

    /// Resolves the columns of a mapping.
    ///
    /// The default mapping applies to the columns that exist. Their names must then be those of a
    /// recording or describe a quantity, such as `gyro_x (deg/s)`.
    fn column_groups(&self, mapping: &Mapping) -> Result<ColumnGroups, ImportError> {
        let path = self.columns.first().map(|(path, _)| path.clone()).unwrap_or_default();
        self.resolve(mapping).map_err(|error| match error {
            error if mapping.is_explicit() => error,
            ImportError::AmbiguousColumn { target, alternatives, .. } if alternatives.len() > 1 => {
                ImportError::AmbiguousHeader { path, target, map: self.map_line(mapping), alternatives }
            }
            error => match (self.recording_error(), error) {
                (Some(error), _) => error.into(),
                (None, ImportError::UnknownColumn { .. }) => {
                    ImportError::MappingRequired { path, map: self.map_line(mapping), columns: self.column_names() }
                }
                (None, error) => error,
            },
        })
    }

    /// Returns the error for a misspelt column name in a recording. The input counts as a recording
    /// if it is a single file that has most columns of a recording.
    fn recording_error(&self) -> Option<RecordingError> {
        let [(path, names)] = &self.columns[..] else { return None };
        let known = RECORDING_COLUMNS.iter().filter(|known| names.iter().any(|name| name.raw() == **known)).count();
        if 2 * known <= RECORDING_COLUMNS.len() {
            return None;
        }
        recording::Reader::open(path).err().filter(RecordingError::suggests_name)
    }

    /// Returns a value of `--map` to suggest for these files. The value contains the first column
    /// that may hold each target, and `COLUMN` for a required column that is not recognised.
    fn map_line(&self, mapping: &Mapping) -> ForeignText {
        let names = || self.columns.iter().flat_map(|(_, names)| names).map(ForeignText::raw);
        let column = |target: &str| {
            let ranked = names().filter_map(|name| Some((mapping.match_rank(target, name)?, name)));
            ranked.min_by_key(|(rank, _)| *rank).map(|(_, name)| name)
        };
        let has_field = FIELD.into_iter().all(|target| column(target).is_some());
        let targets = ["t"].into_iter().chain(RATE).chain(FORCE).chain(FIELD.into_iter().filter(|_| has_field));
        let pairs = targets.map(|target| format!("{target}={}", column(target).unwrap_or("COLUMN")));
        foreign::shell_word(&pairs.collect::<Vec<_>>().join(",")).into()
    }

    fn resolve(&self, mapping: &Mapping) -> Result<ColumnGroups, ImportError> {
        let is_wanted = |targets: &[&'static str]| {
            let exists = |target: &&'static str| {
                let columns = self.columns.iter().flat_map(|(_, names)| names);
                columns.into_iter().any(|name| mapping.match_rank(target, name.raw()).is_some())
            };
            mapping.is_explicit() || targets.iter().all(exists)
        };
        let field =
            (mapping.has_field() && is_wanted(&FIELD)).then(|| self.column_group(mapping, FIELD)).transpose()?;
        let reference = (mapping.has_reference() && is_wanted(&REFERENCE))
            .then(|| self.column_group(mapping, REFERENCE))
            .transpose()?;
        let velocity = mapping.velocity().filter(|targets| is_wanted(targets));
        let velocity = velocity.map(|targets| self.column_group(mapping, targets)).transpose()?;
        let velocity = match velocity {
            Some(group) => Some((self.position_columns(mapping, &group.path, &is_wanted)?, group)),
            None => None,
        };
        let scored = mapping.column(SCORED).filter(|_| is_wanted(&[SCORED]));
        let scored = scored.map(|column| self.find_column(mapping, SCORED, column, None)).transpose()?;
        let scored = scored.and_then(|(file, index)| Some((self.columns.get(file)?.0.clone(), index)));
        let (rate, force) = (self.column_group(mapping, RATE)?, self.column_group(mapping, FORCE)?);
        Ok(ColumnGroups { rate, force, field, reference, velocity, scored })
    }

    /// Returns the samples of a column group in file order.
    ///
    /// Rows for which `convert` returns `None` and malformed rows are skipped.
    fn samples<'a, const N: usize, T: 'a>(
        &self,
        group: &ColumnGroup<N>,
        time_digits: usize,
        mut convert: impl FnMut(&CsvRecord<'_>, i64, [f64; N]) -> Option<T> + 'a,
    ) -> Result<Samples<'a, T>, ImportError> {
        let indices = group.indices;
        self.rows(&group.path, group.time, time_digits, move |record, t_ns| {
            convert(record, t_ns, record.numbers(indices).ok().flatten()?)
        })
    }

    /// Converts the rows of a file with `convert`, in file order.
    ///
    /// Rows for which `convert` returns `None` and malformed rows are skipped. The survey has
    /// counted the malformed ones.
    fn rows<'a, T: 'a>(
        &self,
        path: &Path,
        time: usize,
        time_digits: usize,
        mut convert: impl FnMut(&CsvRecord<'_>, i64) -> Option<T> + 'a,
    ) -> Result<Samples<'a, T>, ImportError> {
        let mut reader = CsvReader::open(path, &self.read_bytes)?;
        let mut next = move || -> Result<Option<T>, ImportError> {
            loop {
                let record = match reader.next() {
                    Ok(Some(record)) => record,
                    Ok(None) => return Ok(None),
                    Err(ImportError::Malformed { .. }) => continue,
                    Err(error) => return Err(error),
                };
                let time = record.time(time, time_digits).ok();
                if let Some(converted) = time.and_then(|time| convert(&record, time.ns())) {
                    return Ok(Some(converted));
                }
            }
        };
        Ok(Box::new(iter::from_fn(move || next().transpose())))
    }

    /// Returns the position columns, which must be in the same file as the velocity.
    fn position_columns(
        &self,
        mapping: &Mapping,
        path: &Path,
        is_wanted: &dyn Fn(&[&'static str]) -> bool,
    ) -> Result<[Option<usize>; 3], ImportError> {
        let file = self.columns.iter().position(|(other, _)| other == path);
        let find = |target: &'static str| -> Result<Option<usize>, ImportError> {
            let column = mapping.column(target).filter(|_| is_wanted(&[target]));
            let column = column.map(|column| self.find_column(mapping, target, column, file));
            Ok(column.transpose()?.map(|(_, index)| index))
        };
        let [latitude, longitude, altitude] = POSITION.map(find);
        Ok([latitude?, longitude?, altitude?])
    }

    fn column_group<const N: usize>(
        &self,
        mapping: &Mapping,
        group: [&'static str; N],
    ) -> Result<ColumnGroup<N>, ImportError> {
        let mut positions = [(0, 0); N];
        for (position, target) in positions.iter_mut().zip(group) {
            *position = self.find_column(mapping, target, mapping.column(target).unwrap_or_default(), None)?;
        }
        let file = positions[0].0;
        if positions.iter().any(|(other, _)| *other != file) {
            let files = positions.map(|(file, _)| file_name(&self.columns[file].0));
            return Err(ImportError::SplitVector { group: group.into(), files: files.map(ForeignText::from).into() });
        }
        let (_, time) = self.find_column(mapping, "t", mapping.column("t").unwrap_or_default(), Some(file))?;
        Ok(ColumnGroup { path: self.columns[file].0.clone(), time, indices: positions.map(|(_, index)| index) })
    }

    /// Returns the file and the index of a column.
    ///
    /// The name must be unique in the file `only`, or among all files if `only` is `None`.
    fn find_column(
        &self,
        mapping: &Mapping,
        target: &'static str,
        found: &str,
        only: Option<usize>,
    ) -> Result<(usize, usize), ImportError> {
        let matching_columns = |is_match: &dyn Fn(&str) -> bool, in_file: Option<&str>| -> Vec<(usize, usize)> {
            let files = self.columns.iter().enumerate().filter(|(index, (path, _))| {
                only.is_none_or(|only| *index == only) && in_file.is_none_or(|named| matches_name(path, named))
            });
            let positions = files.flat_map(|(file, (_, names))| {
                let indices = names.iter().enumerate().filter(|(_, name)| is_match(name.raw()));
                indices.map(move |(index, _)| (file, index))
            });
            positions.collect()
        };
        let mut ranks: Vec<u8> = self
            .columns
            .iter()
            .flat_map(|(_, names)| names)
            .filter_map(|name| mapping.match_rank(target, name.raw()))
            .collect();
        ranks.sort_unstable();
        ranks.dedup();
        let of_rank = |rank: u8| matching_columns(&|name| mapping.match_rank(target, name) == Some(rank), None);
        let mut positions = ranks.into_iter().map(of_rank).find(|positions| !positions.is_empty()).unwrap_or_default();
        if let (true, Some((file, column))) = (positions.is_empty(), found.rsplit_once(':')) {
            positions = matching_columns(&|name| name == column, Some(file));
            if positions.is_empty() {
                positions = matching_columns(&|name| without_unit(name) == column, Some(file));
            }
        }
        match positions[..] {
            [position] => Ok(position),
            [] => {
                let known = only.map_or_else(|| self.column_names(), |only| self.columns[only].1.clone());
                let near = nearest(found, known.iter().map(ForeignText::raw)).map(ForeignText::from);
                Err(ImportError::UnknownColumn { target, found: found.into(), near, known })
            }
            _ => {
                let qualified_name = |&(file, index): &(usize, usize)| {
                    let (path, names) = &self.columns[file];
                    ForeignText::from(format!("{}:{}", stem(path), names[index].raw()))
                };
                let mut alternatives: Vec<_> = positions.iter().map(qualified_name).collect();
                let count = alternatives.len();
                alternatives.dedup();
                if alternatives.len() < count {
                    alternatives = vec!["different column names in the header".into()];
                }
                Err(ImportError::AmbiguousColumn { target, found: found.into(), alternatives })
            }
        }
    }
}

fn matches_name(path: &Path, name: &str) -> bool {
    name == file_name(path) || name == stem(path)
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the file name with `.gz` or `.zst`, and the extension, removed.
fn stem(path: &Path) -> String {
    let name = file_name(path);
    let name = [".gz", ".zst"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(&name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}
