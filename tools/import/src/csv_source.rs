//! Source that joins mapped columns of CSV files by time.
//!
//! Input: CSV files and a mapping.
//!
//! Output: rows at the times of the rate samples.
//!
//! Time: each file has its own time column. All files share one clock.
//!
//! Failure: a missing column and the first malformed line are errors.

use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use foreign::ForeignText;
use mapping::{FIELD, FORCE, POSITION, RATE, REFERENCE, names::nearest};
use recording::Reference;

use crate::{
    Format, ImportError, Mapping, Note,
    csv_reader::CsvReader,
    error::open_error,
    force_aligner::ForceAligner,
    row_writer::Sample,
    row_writer::{Attitude, RowWriter, Samples},
    source::{FixSink, ReceiverFix, Source, Survey},
};

/// CSV files with a mapping of their columns.
pub(crate) struct CsvSource<'a> {
    files: CsvFiles,
    groups: ColumnGroups,
    mapping: &'a Mapping,
    length_bytes: u64,
}

impl<'a> CsvSource<'a> {
    /// Opens the files, reads their headers and resolves the mapping.
    pub(crate) fn open(paths: &[PathBuf], mapping: &'a Mapping) -> Result<Self, ImportError> {
        let files = CsvFiles::open(paths)?;
        let groups = files.column_groups(mapping)?;
        let length = |path: &Path| fs::metadata(path).map(|found| found.len()).map_err(|cause| open_error(path, cause));
        let length_bytes = files.read_bytes() + groups.paths().map(length).sum::<Result<u64, _>>()?;
        Ok(Self { files, groups, mapping, length_bytes })
    }
}

impl CsvSource<'_> {
    /// Reads the fixes in a column group and returns the number of skipped fixes.
    ///
    /// A fix is skipped if its timestamp does not increase. If the fixes are in the same file as
    /// the rates, several rows repeat one fix, which is then passed on only once.
    fn read_fixes(
        &self,
        group: &ColumnGroup<3>,
        position: [Option<usize>; 3],
        on_fix: &mut FixSink<'_>,
    ) -> Result<u64, ImportError> {
        let mut reader = CsvReader::open(&group.path, &self.files.read_bytes)?;
        let is_repeated = group.path == self.groups.rate.path;
        let (mut last, mut out_of_order) = (None, 0);
        while let Some(record) = reader.next()? {
            let Some(velocity) = record.numbers(group.indices)? else { continue };
            let t_ns = record.time_ns(group.time, self.mapping.time_digits())?;
            let mut location = [f64::NAN; 3];
            for (part, index) in location.iter_mut().zip(position) {
                if let Some([number]) = index.map(|index| record.numbers([index])).transpose()?.flatten() {
                    *part = number;
                }
            }
            if last.is_some_and(|(last_ns, _, _)| t_ns <= last_ns) {
                out_of_order += 1;
                continue;
            }
            let values = (velocity.map(f64::to_bits), location.map(f64::to_bits));
            if is_repeated && last.is_some_and(|(_, found, place)| (found, place) == values) {
                continue;
            }
            last = Some((t_ns, values.0, values.1));
            let [latitude_deg, longitude_deg, altitude_m] = location;
            let velocity_m_s = self.mapping.velocity_m_s(velocity);
            on_fix(&ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })?;
        }
        Ok(out_of_order)
    }
}

impl Source for CsvSource<'_> {
    fn format(&self) -> Format {
        Format::Csv
    }

    /// Returns the number of bytes to read: the headers, then the file of each column group once.
    fn total_bytes(&self) -> u64 {
        self.length_bytes
    }

    fn survey(&mut self, on_fix: &mut FixSink<'_>, progress: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut notes = Vec::new();
        if let Some((position, group)) = &self.groups.velocity {
            let out_of_order = self.read_fixes(group, *position, on_fix)?;
            progress(self.files.read_bytes());
            if out_of_order > 0 {
                let reason = "timestamps do not increase";
                notes.push(Note::Skipped { what: "fixes", count: out_of_order, reason });
            }
        }
        let expected = "numbers in the mapped columns, with times of one clock".into();
        let ColumnGroups { field, reference, .. } = &self.groups;
        Ok(Survey { has_field: field.is_some(), has_reference: reference.is_some(), notes, reason: None, expected })
    }

    fn field_samples(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(group) = &self.groups.field else { return Ok(Box::new(std::iter::empty())) };
        let mapping = self.mapping;
        let convert = |t_ns, found| Some((t_ns, mapping.field_ut(found)));
        Ok(Box::new(self.files.samples(group, mapping.time_digits(), convert)?))
    }

    fn reference_attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some(group) = &self.groups.reference else { return Ok(Box::new(std::iter::empty())) };
        let mapping = self.mapping;
        let convert = |t_ns, found| {
            let reference = Reference { quaternion: mapping.reference(found)?, scored: true };
            Some(Attitude { t_ns, reference, reset_counter: Some(0) })
        };
        Ok(Box::new(self.files.samples(group, mapping.time_digits(), convert)?))
    }

    fn write_rows(&self, rows: &mut RowWriter, progress: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let (digits, mapping) = (self.mapping.time_digits(), self.mapping);
        let mut rates =
            self.files.samples(&self.groups.rate, digits, |t_ns, found| Some((t_ns, mapping.rate_rad_s(found))))?;
        let mut forces =
            self.files.samples(&self.groups.force, digits, |t_ns, found| Some((t_ns, mapping.force_m_s2(found))))?;
        let mut aligner = ForceAligner::default();
        let (mut rate, mut force) = (rates.next().transpose()?, forces.next().transpose()?);
        for count in 0u64.. {
            if count.is_multiple_of(1024) {
                progress(self.files.read_bytes());
            }
            match (rate, force) {
                (Some(sample), Some((force_ns, _))) if sample.0 < force_ns => {
                    aligner.push_rate(sample, rows)?;
                    rate = rates.next().transpose()?;
                }
                (_, Some(sample)) => {
                    aligner.push_force(sample, rows)?;
                    force = forces.next().transpose()?;
                }
                (Some(sample), None) => {
                    aligner.push_rate(sample, rows)?;
                    rate = rates.next().transpose()?;
                }
                (None, None) => break,
            }
        }
        aligner.finish(rows)?;
        progress(self.files.read_bytes());
        Ok(aligner)
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
}

impl ColumnGroups {
    /// Returns the path of the file of each column group.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        let velocity = self.velocity.iter().map(|(_, group)| group);
        let vectors = [&self.rate, &self.force].into_iter().chain(&self.field).chain(velocity);
        vectors.map(|group| &group.path).chain(self.reference.iter().map(|group| &group.path)).map(PathBuf::as_path)
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

    fn column_groups(&self, mapping: &Mapping) -> Result<ColumnGroups, ImportError> {
        let field = mapping.has_field().then(|| self.column_group(mapping, FIELD)).transpose()?;
        let reference = mapping.has_reference().then(|| self.column_group(mapping, REFERENCE)).transpose()?;
        let velocity = mapping.velocity().map(|targets| self.column_group(mapping, targets)).transpose()?;
        let velocity = match velocity {
            Some(group) => Some((self.position_columns(mapping, &group.path)?, group)),
            None => None,
        };
        let (rate, force) = (self.column_group(mapping, RATE)?, self.column_group(mapping, FORCE)?);
        Ok(ColumnGroups { rate, force, field, reference, velocity })
    }

    /// Returns the samples of a group in file order.
    ///
    /// Rows for which `convert` returns `None` are skipped.
    fn samples<const N: usize, T, F: Fn(i64, [f64; N]) -> Option<T>>(
        &self,
        group: &ColumnGroup<N>,
        time_digits: usize,
        convert: F,
    ) -> Result<impl Iterator<Item = Result<T, ImportError>> + use<N, T, F>, ImportError> {
        let mut reader = CsvReader::open(&group.path, &self.read_bytes)?;
        let (time, indices) = (group.time, group.indices);
        let mut next = move || -> Result<Option<T>, ImportError> {
            while let Some(record) = reader.next()? {
                if let Some(values) = record.numbers(indices)?
                    && let Some(sample) = convert(record.time_ns(time, time_digits)?, values)
                {
                    return Ok(Some(sample));
                }
            }
            Ok(None)
        };
        Ok(std::iter::from_fn(move || next().transpose()))
    }

    /// Returns the position columns, which must be in the same file as the velocity.
    fn position_columns(&self, mapping: &Mapping, path: &Path) -> Result<[Option<usize>; 3], ImportError> {
        let file = self.columns.iter().position(|(other, _)| other == path);
        let find = |target: &'static str| -> Result<Option<usize>, ImportError> {
            let column = mapping.column(target).map(|column| self.find_column(target, column, file));
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
            *position = self.find_column(target, mapping.column(target).unwrap_or_default(), None)?;
        }
        let file = positions[0].0;
        if positions.iter().any(|(other, _)| *other != file) {
            let files = positions.map(|(file, _)| file_name(&self.columns[file].0));
            return Err(ImportError::SplitVector { group: group.into(), files: files.map(ForeignText::from).into() });
        }
        let (_, time) = self.find_column("t", mapping.column("t").unwrap_or_default(), Some(file))?;
        Ok(ColumnGroup { path: self.columns[file].0.clone(), time, indices: positions.map(|(_, index)| index) })
    }

    /// Returns the file and the index of a column.
    ///
    /// The name must be unique in the file `only`, or among all files if `only` is `None`.
    fn find_column(
        &self,
        target: &'static str,
        found: &str,
        only: Option<usize>,
    ) -> Result<(usize, usize), ImportError> {
        let matching_columns = |name: &str, in_file: Option<&str>| -> Vec<(usize, usize)> {
            let files = self.columns.iter().enumerate().filter(|(index, (path, _))| {
                only.is_none_or(|only| *index == only) && in_file.is_none_or(|named| matches_name(path, named))
            });
            let positions = files.flat_map(|(file, (_, names))| {
                let indices = names.iter().enumerate().filter(|(_, other)| **other == *name);
                indices.map(move |(index, _)| (file, index))
            });
            positions.collect()
        };
        let mut positions = matching_columns(found, None);
        if let (true, Some((file, name))) = (positions.is_empty(), found.rsplit_once(':')) {
            positions = matching_columns(name, Some(file));
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

/// Returns the file name with `.gz` and the extension removed.
fn stem(path: &Path) -> String {
    let name = file_name(path);
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}
