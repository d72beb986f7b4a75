//! A headed text of numbers, line by line: what every kind of recording has in common.

use std::{
    io,
    path::{Path, PathBuf},
};

use csv::ByteRecord;

use crate::{
    columns,
    error::{Fault, Position, RecordingError},
    input::{Lines, unquoted},
};

/// A file with a header that says where its columns `C` are; ends after the first error.
pub(crate) struct Table<C> {
    path: PathBuf,
    lines: Lines,
    names: Vec<&'static str>,
    columns: C,
    record: ByteRecord,
    rows: u64,
    ended: bool,
}

impl<C> Table<C> {
    /// Opens a file and reads its header, whose names are among `known`.
    pub(crate) fn open(
        path: &Path,
        known: &'static [&'static str],
        columns: impl FnOnce(&[&'static str]) -> Result<C, Fault>,
    ) -> Result<Self, RecordingError> {
        let mut lines = Lines::open(path).map_err(|cause| RecordingError::Open {
            path: path.to_owned(),
            remedy: remedy(cause.kind()),
            cause,
        })?;
        let mut record = ByteRecord::new();
        let header = match lines.next(&mut record) {
            Ok(Some(line)) => columns::names(&record, line, known)
                .and_then(|names| Ok((columns(&names).map_err(|fault| (Position::line(line), fault))?, names))),
            Ok(None) => Err((Position::line(1), Fault::Empty)),
            Err(malformed) => Err(malformed),
        };
        match header {
            Ok((columns, names)) => {
                Ok(Self { path: path.to_owned(), lines, names, columns, record, rows: 0, ended: false })
            }
            Err((place, fault)) => Err(RecordingError::Malformed { path: path.to_owned(), place, fault }),
        }
    }

    /// What `row` makes of the next line; `None` at the end.
    pub(crate) fn next<T>(
        &mut self,
        row: impl FnOnce(&Fields<'_>, &C) -> Result<T, (Position, Fault)>,
    ) -> Option<Result<T, RecordingError>> {
        if self.ended {
            return None;
        }
        let row = self
            .next_row(row)
            .map_err(|(place, fault)| RecordingError::Malformed { path: self.path.clone(), place, fault })
            .transpose();
        self.ended = !matches!(row, Some(Ok(_)));
        row
    }

    fn next_row<T>(
        &mut self,
        row: impl FnOnce(&Fields<'_>, &C) -> Result<T, (Position, Fault)>,
    ) -> Result<Option<T>, (Position, Fault)> {
        let Some(line) = self.lines.next(&mut self.record)? else {
            return if self.rows == 0 { Err((Position::line(self.lines.line() - 1), Fault::NoRows)) } else { Ok(None) };
        };
        self.rows += 1;
        let fields = Fields { record: &self.record, names: &self.names, line };
        fields.check()?;
        row(&fields, &self.columns).map(Some)
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
pub(crate) struct Fields<'a> {
    record: &'a ByteRecord,
    names: &'a [&'static str],
    line: u64,
}

impl Fields<'_> {
    /// Refuses a line that is not as long as the header, or no text.
    fn check(&self) -> Result<(), (Position, Fault)> {
        let (found, expected) = (self.record.len(), self.names.len());
        if found != expected {
            return Err((self.place(found.min(expected)), Fault::RowLength { found, expected }));
        }
        if !self.record.as_slice().is_ascii() {
            (0..found).try_for_each(|index| self.text(index).map(drop))?;
        }
        Ok(())
    }

    pub(crate) fn numbers<const N: usize>(&self, indices: [usize; N]) -> Result<[f64; N], (Position, Fault)> {
        let mut values = [0.0; N];
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.parsed(index, "a number", |text| text.parse().ok())?;
        }
        Ok(values)
    }

    pub(crate) fn parsed<T>(
        &self,
        index: usize,
        expected: &'static str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<T, (Position, Fault)> {
        let text = self.text(index)?;
        parse(text).ok_or_else(|| (self.place(index), Fault::value(text.as_bytes(), expected)))
    }

    fn text(&self, index: usize) -> Result<&str, (Position, Fault)> {
        let field = unquoted(&self.record[index]);
        str::from_utf8(field).map_err(|_| (self.place(index), Fault::value(field, "UTF-8 text")))
    }

    fn place(&self, index: usize) -> Position {
        Position::field(self.line, index, self.names.get(index).copied())
    }
}
