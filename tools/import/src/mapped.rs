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

use crate::{
    Format, ImportError, Mapping,
    aligned::{Aligned, Sample},
    error::{nearest, opening},
    mapping::{FIELD, FORCE, RATE},
    rows::{Attitude, Rows, Samples},
    source::{Source, Survey, TakeFix},
    text::Text,
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

impl Source for Table<'_> {
    fn format(&self) -> Format {
        Format::Csv
    }

    /// Each group reads its file.
    fn total_bytes(&self) -> u64 {
        self.length_bytes
    }

    fn survey(&mut self, _: &mut TakeFix<'_>, _: &mut dyn FnMut(u64)) -> Result<Survey, ImportError> {
        let expected = "numbers in the columns of --map, at times of one clock".into();
        Ok(Survey { has_field: self.groups.field.is_some(), expected, ..Survey::default() })
    }

    fn fields(&self) -> Result<Samples<'_, Sample>, ImportError> {
        let Some(group) = &self.groups.field else { return Ok(Box::new(std::iter::empty())) };
        let samples = self.files.samples(group, self.mapping.time_digits(), |found| self.mapping.field_ut(found))?;
        Ok(Box::new(samples))
    }

    fn attitudes(&self) -> Result<Samples<'_, Attitude>, ImportError> {
        Ok(Box::new(std::iter::empty()))
    }

    fn rows(&self, rows: &mut Rows, tell: &mut dyn FnMut(u64)) -> Result<Aligned, ImportError> {
        let (digits, mapping) = (self.mapping.time_digits(), self.mapping);
        let mut rates = self.files.samples(&self.groups.rate, digits, |found| mapping.rate_rad_s(found))?;
        let mut forces = self.files.samples(&self.groups.force, digits, |found| mapping.force_m_s2(found))?;
        let mut aligned = Aligned::default();
        let (mut rate, mut force) = (rates.next().transpose()?, forces.next().transpose()?);
        for count in 0u64.. {
            if count.is_multiple_of(1024) {
                tell(self.files.read_bytes());
            }
            match (rate, force) {
                (Some(sample), Some((force_ns, _))) if sample.0 < force_ns => {
                    aligned.rate(sample, rows)?;
                    rate = rates.next().transpose()?;
                }
                (_, Some(sample)) => {
                    aligned.force(sample, rows)?;
                    force = forces.next().transpose()?;
                }
                (Some(sample), None) => {
                    aligned.rate(sample, rows)?;
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
struct Group {
    path: PathBuf,
    time: usize,
    indices: [usize; 3],
}

/// Which columns are rate, force and field.
struct Groups {
    rate: Group,
    force: Group,
    field: Option<Group>,
}

impl Groups {
    /// The file of each.
    fn paths(&self) -> impl Iterator<Item = &Path> {
        [&self.rate, &self.force].into_iter().chain(&self.field).map(|group| group.path.as_path())
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
        Ok(Groups { rate: self.group(mapping, RATE)?, force: self.group(mapping, FORCE)?, field })
    }

    /// The samples of a group, in the order of its file.
    fn samples<F: Fn([f64; 3]) -> [f64; 3]>(
        &self,
        group: &Group,
        time_digits: usize,
        convert: F,
    ) -> Result<impl Iterator<Item = Result<Sample, ImportError>> + use<F>, ImportError> {
        let mut text = Text::open(&group.path, &self.read_bytes)?;
        let (time, indices) = (group.time, group.indices);
        let mut next = move || -> Result<Option<Sample>, ImportError> {
            while let Some(fields) = text.next()? {
                if let Some(values) = fields.numbers(indices)? {
                    return Ok(Some((fields.time_ns(time, time_digits)?, convert(values))));
                }
            }
            Ok(None)
        };
        Ok(std::iter::from_fn(move || next().transpose()))
    }

    fn group(&self, mapping: &Mapping, group: [&'static str; 3]) -> Result<Group, ImportError> {
        let places = group.map(|target| self.find(target, mapping.column(target).unwrap_or_default(), None));
        let [x, y, z] = places;
        let places = [x?, y?, z?];
        let file = places[0].0;
        if places.iter().any(|(other, _)| *other != file) {
            let files = places.map(|(file, _)| shown(&self.columns[file].0));
            return Err(ImportError::Split { group, files: files.into() });
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
