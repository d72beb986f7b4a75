//! The columns of CSV files, joined by time.
//!
//! Input: files and a mapping. Output: rows at the times of the rate. Time: that of each sample is in its own file; files have one
//! clock. Failure: a column that is not there, the first malformed line.

use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use mapping::{FIELD, FORCE, POSITION, RATE, REFERENCE, names::nearest};
use recording::Reference;

use crate::{
    Format, ImportError, Mapping, Note,
    force_aligner::{ForceAligner, Sample},
    error::opening,
    row_writer::{Attitude, RowWriter, Samples},
    source::{Fixed, Source, Survey, TakeFix},
    csv_reader::Text,
};

/// Files and which of their columns are what.
pub(crate) struct Table<'a> {
    files: Files,
    groups: Groups,
    mapping: &'a Mapping,
    length_bytes: u64,
}

impl<'a> Table<'a> {
    /// Reads the headers.
    pub(crate) fn open(paths: &[PathBuf], mapping: &'a Mapping) -> Result<Self, ImportError> {
        let files = Files::open(paths)?;
        let groups = files.groups(mapping)?;
        let length = |path: &Path| fs::metadata(path).map(|found| found.len()).map_err(|cause| opening(path, cause));
        let length_bytes = files.read_bytes() + groups.paths().map(length).sum::<Result<u64, _>>()?;
        Ok(Self { files, groups, mapping, length_bytes })
    }
}

impl Table<'_> {
    /// Hands the fixes over, each once however many rows of the rate repeat it; tells how many are not after the one before them.
    fn fixes(
        &self,
        group: &Group<3>,
        position: [Option<usize>; 3],
        take: &mut TakeFix<'_>,
    ) -> Result<u64, ImportError> {
        let mut text = Text::open(&group.path, &self.files.read_bytes)?;
        let is_repeated = group.path == self.groups.rate.path;
        let (mut last, mut not_after) = (None, 0);
        while let Some(fields) = text.next()? {
            let Some(found) = fields.numbers(group.indices)? else { continue };
            let t_ns = fields.time_ns(group.time, self.mapping.time_digits())?;
            let mut place = [f64::NAN; 3];
            for (part, index) in place.iter_mut().zip(position) {
                if let Some([number]) = index.map(|index| fields.numbers([index])).transpose()?.flatten() {
                    *part = number;
                }
            }
            if last.is_some_and(|(last_ns, _, _)| t_ns <= last_ns) {
                not_after += 1;
                continue;
            }
            let said = (found.map(f64::to_bits), place.map(f64::to_bits));
            if is_repeated && last.is_some_and(|(_, found, place)| (found, place) == said) {
                continue;
            }
            last = Some((t_ns, said.0, said.1));
            let [latitude_deg, longitude_deg, altitude_m] = place;
            let velocity_m_s = self.mapping.velocity_m_s(found);
            take(&Fixed { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })?;
        }
        Ok(not_after)
    }
}

impl Source for Table<'_> {
    fn format(&self) -> Format {
        Format::Csv
    }

    /// Each group reads its file.
    fn total_bytes(&self) -> u64 {
        self.length_bytes
    }

    fn survey(&mut self, take: &mut TakeFix<'_>, tell: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let mut notes = Vec::new();
        if let Some((position, group)) = &self.groups.velocity {
            let not_after = self.fixes(group, *position, take)?;
            tell(self.files.read_bytes());
            if not_after > 0 {
                let why = "they are not later than the one before them";
                notes.push(Note::LeftOut { what: "fixes", count: not_after, why });
            }
        }
        let expected = "numbers in the columns of --map, at times of one clock".into();
        let Groups { field, reference, .. } = &self.groups;
        Ok(Survey { has_field: field.is_some(), has_reference: reference.is_some(), notes, reason: None, expected })
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(group) = &self.groups.field else { return Ok(Box::new(std::iter::empty())) };
        let mapping = self.mapping;
        let convert = |t_ns, found| Some((t_ns, mapping.field_ut(found)));
        Ok(Box::new(self.files.samples(group, mapping.time_digits(), convert)?))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        let Some(group) = &self.groups.reference else { return Ok(Box::new(std::iter::empty())) };
        let mapping = self.mapping;
        let convert = |t_ns, found| {
            let reference = Reference { quaternion: mapping.reference(found)?, scored: true };
            Some(Attitude { t_ns, reference, reset_counter: Some(0) })
        };
        Ok(Box::new(self.files.samples(group, mapping.time_digits(), convert)?))
    }

    fn rows(&self, rows: &mut RowWriter, tell: &mut dyn FnMut(u64)) -> Result<ForceAligner, ImportError> {
        let (digits, mapping) = (self.mapping.time_digits(), self.mapping);
        let mut rates =
            self.files.samples(&self.groups.rate, digits, |t_ns, found| Some((t_ns, mapping.rate_rad_s(found))))?;
        let mut forces =
            self.files.samples(&self.groups.force, digits, |t_ns, found| Some((t_ns, mapping.force_m_s2(found))))?;
        let mut aligned = ForceAligner::default();
        let (mut rate, mut force) = (rates.next().transpose()?, forces.next().transpose()?);
        for count in 0u64.. {
            if count.is_multiple_of(1024) {
                tell(self.files.read_bytes());
            }
            match (rate, force) {
                (Some(sample), Some((force_ns, _))) if sample.0 < force_ns => {
                    aligned.push_rate(sample, rows)?;
                    rate = rates.next().transpose()?;
                }
                (_, Some(sample)) => {
                    aligned.push_force(sample, rows)?;
                    force = forces.next().transpose()?;
                }
                (Some(sample), None) => {
                    aligned.push_rate(sample, rows)?;
                    rate = rates.next().transpose()?;
                }
                (None, None) => break,
            }
        }
        aligned.finish(rows)?;
        tell(self.files.read_bytes());
        Ok(aligned)
    }
}

/// Files and the columns of each.
pub(crate) struct Files {
    columns: Vec<(PathBuf, Vec<String>)>,
    read_bytes: Rc<Cell<u64>>,
}

/// The columns of one vector and the file they are in.
struct Group<const N: usize> {
    path: PathBuf,
    time: usize,
    indices: [usize; N],
}

/// Which columns are what.
struct Groups {
    rate: Group<3>,
    force: Group<3>,
    field: Option<Group<3>>,
    reference: Option<Group<4>>,
    /// After the columns of the position in the same file.
    velocity: Option<([Option<usize>; 3], Group<3>)>,
}

impl Groups {
    /// The file of each.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        let velocity = self.velocity.iter().map(|(_, group)| group);
        let vectors = [&self.rate, &self.force].into_iter().chain(&self.field).chain(velocity);
        vectors.map(|group| &group.path).chain(self.reference.iter().map(|group| &group.path)).map(PathBuf::as_path)
    }
}

impl Files {
    /// Reads the headers.
    pub(crate) fn open(paths: &[PathBuf]) -> Result<Self, ImportError> {
        let read_bytes = Rc::new(Cell::new(0));
        let columns = paths.iter().map(|path| Ok((path.clone(), Text::open(path, &read_bytes)?.names)));
        Ok(Self { columns: columns.collect::<Result<_, ImportError>>()?, read_bytes })
    }

    /// All columns, each once.
    pub(crate) fn known(&self) -> Vec<String> {
        let mut known: Vec<String> = Vec::new();
        for name in self.columns.iter().flat_map(|(_, names)| names) {
            if !known.contains(name) {
                known.push(name.clone());
            }
        }
        known
    }

    /// What has been read so far.
    fn read_bytes(&self) -> u64 {
        self.read_bytes.get()
    }

    fn groups(&self, mapping: &Mapping) -> Result<Groups, ImportError> {
        let field = mapping.has_field().then(|| self.group(mapping, FIELD)).transpose()?;
        let reference = mapping.has_reference().then(|| self.group(mapping, REFERENCE)).transpose()?;
        let velocity = mapping.velocity().map(|targets| self.group(mapping, targets)).transpose()?;
        let velocity = match velocity {
            Some(group) => Some((self.position(mapping, &group.path)?, group)),
            None => None,
        };
        let (rate, force) = (self.group(mapping, RATE)?, self.group(mapping, FORCE)?);
        Ok(Groups { rate, force, field, reference, velocity })
    }

    /// The samples of a group, in the order of its file, without those that `convert` has nothing of.
    fn samples<const N: usize, T, F: Fn(i64, [f64; N]) -> Option<T>>(
        &self,
        group: &Group<N>,
        time_digits: usize,
        convert: F,
    ) -> Result<impl Iterator<Item = Result<T, ImportError>> + use<N, T, F>, ImportError> {
        let mut text = Text::open(&group.path, &self.read_bytes)?;
        let (time, indices) = (group.time, group.indices);
        let mut next = move || -> Result<Option<T>, ImportError> {
            while let Some(fields) = text.next()? {
                if let Some(values) = fields.numbers(indices)?
                    && let Some(sample) = convert(fields.time_ns(time, time_digits)?, values)
                {
                    return Ok(Some(sample));
                }
            }
            Ok(None)
        };
        Ok(std::iter::from_fn(move || next().transpose()))
    }

    /// The columns of the position, in the file of the velocity.
    fn position(&self, mapping: &Mapping, path: &Path) -> Result<[Option<usize>; 3], ImportError> {
        let file = self.columns.iter().position(|(other, _)| other == path);
        let find = |target: &'static str| -> Result<Option<usize>, ImportError> {
            let column = mapping.column(target).map(|column| self.find(target, column, file));
            Ok(column.transpose()?.map(|(_, index)| index))
        };
        let [latitude, longitude, altitude] = POSITION.map(find);
        Ok([latitude?, longitude?, altitude?])
    }

    fn group<const N: usize>(&self, mapping: &Mapping, group: [&'static str; N]) -> Result<Group<N>, ImportError> {
        let mut places = [(0, 0); N];
        for (place, target) in places.iter_mut().zip(group) {
            *place = self.find(target, mapping.column(target).unwrap_or_default(), None)?;
        }
        let file = places[0].0;
        if places.iter().any(|(other, _)| *other != file) {
            let files = places.map(|(file, _)| shown(&self.columns[file].0));
            return Err(ImportError::Split { group: group.into(), files: files.into() });
        }
        let (_, time) = self.find("t", mapping.column("t").unwrap_or_default(), Some(file))?;
        Ok(Group { path: self.columns[file].0.clone(), time, indices: places.map(|(_, index)| index) })
    }

    /// The file and the index of a column: in `only` that file, else wherever it is, as long as it is there once.
    fn find(&self, target: &'static str, found: &str, only: Option<usize>) -> Result<(usize, usize), ImportError> {
        let all = |name: &str, in_file: Option<&str>| -> Vec<(usize, usize)> {
            let files = self.columns.iter().enumerate().filter(|(file, (path, _))| {
                only.is_none_or(|only| *file == only) && in_file.is_none_or(|named| is_called(path, named))
            });
            let places = files.flat_map(|(file, (_, names))| {
                let indices = names.iter().enumerate().filter(|(_, other)| *other == name);
                indices.map(move |(index, _)| (file, index))
            });
            places.collect()
        };
        let mut places = all(found, None);
        if let (true, Some((file, name))) = (places.is_empty(), found.rsplit_once(':')) {
            places = all(name, Some(file));
        }
        match places[..] {
            [place] => Ok(place),
            [] => {
                let known = only.map_or_else(|| self.known(), |only| self.columns[only].1.clone());
                let near = nearest(found, known.iter().map(String::as_str)).map(str::to_owned);
                Err(ImportError::UnknownColumn { target, found: found.into(), near, known })
            }
            _ => {
                let shown = |&(file, index): &(usize, usize)| {
                    let (path, names) = &self.columns[file];
                    format!("{}:{}", stem(path), names[index])
                };
                let mut places: Vec<_> = places.iter().map(shown).collect();
                let count = places.len();
                places.dedup();
                if places.len() < count {
                    places = vec!["which by giving each column a name of its own in the header".into()];
                }
                Err(ImportError::Ambiguous { target, found: found.into(), places })
            }
        }
    }
}

fn is_called(path: &Path, name: &str) -> bool {
    name == shown(path) || name == stem(path)
}

fn shown(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The name of a file without `.csv` and `.gz`.
fn stem(path: &Path) -> String {
    let name = shown(path);
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}
