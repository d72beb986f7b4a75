//! Reads a CSV table of numbers line by line; shared by all kinds of recordings.

use std::{
    io,
    path::{Path, PathBuf},
};

use csv::ByteRecord;

use crate::{
    columns,
    error::{ParseError, Position, RecordingError},
    input::{Lines, unquoted},
};

/// CSV file with its columns mapped to `C`. Reading ends after the first error.
pub(crate) struct Table<C> {
    path: PathBuf,
    lines: Lines,
    names: Vec<&'static str>,
    columns: C,
    record: ByteRecord,
    rows: u64,
    is_finished: bool,
}

impl<C> Table<C> {
    /// Opens a file and parses its header. All column names must be in `known`.
    pub(crate) fn open(
        path: &Path,
        known: &'static [&'static str],
        columns: impl FnOnce(&[&'static str]) -> Result<C, ParseError>,
    ) -> Result<Self, RecordingError> {
        let mut lines = Lines::open(path).map_err(|cause| RecordingError::Open {
            path: path.to_owned(),
            remedy: remedy(cause.kind()),
            cause,
        })?;
        let mut record = ByteRecord::new();
        let header = match lines.next(&mut record) {
            Ok(Some(line)) => columns::parse_header(&record, line, known)
                .and_then(|names| Ok((columns(&names).map_err(|fault| (Position::line(line), fault))?, names))),
            Ok(None) => Err((Position::line(1), ParseError::Empty)),
            Err(malformed) => Err(malformed),
        };
        match header {
            Ok((columns, names)) => {
                Ok(Self { path: path.to_owned(), lines, names, columns, record, rows: 0, is_finished: false })
            }
            Err((position, error)) => Err(RecordingError::Malformed { path: path.to_owned(), position, error }),
        }
    }

    /// Parses the next line with the function `row`. Returns `None` at the end of the file or after
    /// an error.
    pub(crate) fn next<T>(
        &mut self,
        row: impl FnOnce(&Fields<'_>, &C) -> Result<T, (Position, ParseError)>,
    ) -> Option<Result<T, RecordingError>> {
        if self.is_finished {
            return None;
        }
        let row = self
            .next_row(row)
            .map_err(|(position, error)| RecordingError::Malformed { path: self.path.clone(), position, error })
            .transpose();
        self.is_finished = !matches!(row, Some(Ok(_)));
        row
    }

    fn next_row<T>(
        &mut self,
        row: impl FnOnce(&Fields<'_>, &C) -> Result<T, (Position, ParseError)>,
    ) -> Result<Option<T>, (Position, ParseError)> {
        let Some(line) = self.lines.next(&mut self.record)? else {
            return if self.rows == 0 {
                Err((Position::line(self.lines.line() - 1), ParseError::NoRows))
            } else {
                Ok(None)
            };
        };
        self.rows += 1;
        let fields = Fields { record: &self.record, names: &self.names, line };
        fields.validate()?;
        row(&fields, &self.columns).map(Some)
    }
}

fn remedy(cause: io::ErrorKind) -> &'static str {
    match cause {
        io::ErrorKind::NotFound => "check the path",
        io::ErrorKind::PermissionDenied => "make it readable for this user",
        io::ErrorKind::IsADirectory => "give the path of a file in it",
        _ => "check that the file can be read",
    }
}

/// Fields of one line.
pub(crate) struct Fields<'a> {
    record: &'a ByteRecord,
    names: &'a [&'static str],
    line: u64,
}

impl Fields<'_> {
    /// Checks that the line has as many fields as the header and is valid UTF-8.
    fn validate(&self) -> Result<(), (Position, ParseError)> {
        let (found, expected) = (self.record.len(), self.names.len());
        if found != expected {
            return Err((self.position(found.min(expected)), ParseError::RowLength { found, expected }));
        }
        if !self.record.as_slice().is_ascii() {
            (0..found).try_for_each(|index| self.text(index).map(drop))?;
        }
        Ok(())
    }

    pub(crate) fn numbers<const N: usize>(&self, indices: [usize; N]) -> Result<[f64; N], (Position, ParseError)> {
        let mut values = [0.0; N];
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.parse(index, "a number", |text| text.parse().ok())?;
        }
        Ok(values)
    }

    pub(crate) fn parse<T>(
        &self,
        index: usize,
        expected: &'static str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<T, (Position, ParseError)> {
        let text = self.text(index)?;
        parse(text).ok_or_else(|| (self.position(index), ParseError::invalid_value(text.as_bytes(), expected)))
    }

    fn text(&self, index: usize) -> Result<&str, (Position, ParseError)> {
        let field = unquoted(&self.record[index]);
        str::from_utf8(field).map_err(|_| (self.position(index), ParseError::invalid_value(field, "UTF-8 text")))
    }

    fn position(&self, index: usize) -> Position {
        Position::field(self.line, index, self.names.get(index).copied())
    }
}
