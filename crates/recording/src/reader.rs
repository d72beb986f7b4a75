//! A recording, row by row.

use crate::{
    columns::Columns,
    error::{Fault, Place, RecordingError},
    input::{Lines, unquoted},
    time,
};
use csv::ByteRecord;
use std::{
    io,
    path::{Path, PathBuf},
};

/// One sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time on the recording's clock, ns.
    pub t_ns: i64,
    /// Body rate, rad/s, sensor axes; as recorded, so it may be nan or infinite.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s², sensor axes; as recorded, so it may be nan or infinite.
    pub force_m_s2: [f64; 3],
    /// Magnetic field, µT, sensor axes; `None` where the recording has none or any component is nan: no sample at this row.
    pub field_ut: Option<[f64; 3]>,
    /// The true attitude, where the recording has one.
    pub reference: Option<Reference>,
}

/// The attitude a sample is judged by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Unit quaternion w, x, y, z, sensor axes to ENU, dimensionless.
    pub quaternion: [f64; 4],
    /// Whether errors count here: `mov` is 1, or the recording has no such column.
    pub scored: bool,
}

/// The rows of a recording, in its order; ends after the first error.
pub struct Reader {
    path: PathBuf,
    lines: Lines,
    columns: Columns,
    record: ByteRecord,
    rows: u64,
    ended: bool,
}

impl Reader {
    /// Opens a recording and reads its header.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut lines = Lines::open(path).map_err(|cause| RecordingError::Open {
            path: path.to_owned(),
            remedy: remedy(cause.kind()),
            cause,
        })?;
        let mut record = ByteRecord::new();
        let columns = match lines.next(&mut record) {
            Ok(Some(line)) => Columns::of_header(&record, line),
            Ok(None) => Err((Place::line(1), Fault::Empty)),
            Err(malformed) => Err(malformed),
        };
        match columns {
            Ok(columns) => Ok(Self { path: path.to_owned(), lines, columns, record, rows: 0, ended: false }),
            Err((place, fault)) => Err(RecordingError::Malformed { path: path.to_owned(), place, fault }),
        }
    }

    fn next_row(&mut self) -> Result<Option<Row>, (Place, Fault)> {
        let Some(line) = self.lines.next(&mut self.record)? else {
            return if self.rows == 0 { Err((Place::line(self.lines.line() - 1), Fault::NoRows)) } else { Ok(None) };
        };
        self.rows += 1;
        Fields { record: &self.record, columns: &self.columns, line }.row().map(Some)
    }
}

impl Iterator for Reader {
    type Item = Result<Row, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let row = self
            .next_row()
            .map_err(|(place, fault)| RecordingError::Malformed { path: self.path.clone(), place, fault })
            .transpose();
        self.ended = !matches!(row, Some(Ok(_)));
        row
    }
}

fn remedy(cause: io::ErrorKind) -> &'static str {
    match cause {
        io::ErrorKind::NotFound => "check the path",
        io::ErrorKind::PermissionDenied => "give this user the right to read it",
        io::ErrorKind::IsADirectory => "name a file in it",
        _ => "check that the file can be read",
    }
}

/// One line, taken apart.
struct Fields<'a> {
    record: &'a ByteRecord,
    columns: &'a Columns,
    line: u64,
}

impl Fields<'_> {
    fn row(&self) -> Result<Row, (Place, Fault)> {
        let (found, expected) = (self.record.len(), self.columns.names.len());
        if found != expected {
            return Err((self.place(found.min(expected)), Fault::RowLength { found, expected }));
        }
        if !self.record.as_slice().is_ascii() {
            (0..found).try_for_each(|index| self.text(index).map(drop))?;
        }
        Ok(Row {
            t_ns: self.parsed(self.columns.time, time::EXPECTED, time::parse_ns)?,
            rate_rad_s: self.numbers(self.columns.rate)?,
            force_m_s2: self.numbers(self.columns.force)?,
            field_ut: self.field()?,
            reference: self.reference()?,
        })
    }

    fn field(&self) -> Result<Option<[f64; 3]>, (Place, Fault)> {
        let Some(indices) = self.columns.field else { return Ok(None) };
        let field = self.numbers(indices)?;
        Ok((!field.iter().any(|part| part.is_nan())).then_some(field))
    }

    fn reference(&self) -> Result<Option<Reference>, (Place, Fault)> {
        let scored = match self.columns.scored {
            Some(index) => self.parsed(index, "0 or 1", flag)?,
            None => true,
        };
        let Some(indices) = self.columns.quaternion else { return Ok(None) };
        let quaternion = self.numbers(indices)?;
        let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
        let turns = length > 0.0 && length.is_finite();
        Ok(turns.then(|| Reference { quaternion: quaternion.map(|part| part / length), scored }))
    }

    fn numbers<const N: usize>(&self, indices: [usize; N]) -> Result<[f64; N], (Place, Fault)> {
        let mut values = [0.0; N];
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.parsed(index, "a number", |text| text.parse().ok())?;
        }
        Ok(values)
    }

    fn parsed<T>(
        &self,
        index: usize,
        expected: &'static str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<T, (Place, Fault)> {
        let text = self.text(index)?;
        parse(text).ok_or_else(|| (self.place(index), Fault::value(text.as_bytes(), expected)))
    }

    fn text(&self, index: usize) -> Result<&str, (Place, Fault)> {
        let field = unquoted(&self.record[index]);
        str::from_utf8(field).map_err(|_| (self.place(index), Fault::value(field, "UTF-8 text")))
    }

    fn place(&self, index: usize) -> Place {
        Place::field(self.line, index, self.columns.names.get(index).copied())
    }
}

fn flag(text: &str) -> Option<bool> {
    match text.parse::<f64>() {
        Ok(0.0) => Some(false),
        Ok(1.0) => Some(true),
        _ => None,
    }
}
