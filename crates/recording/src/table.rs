//! Reads a CSV table of numbers line by line; shared by all kinds of recordings.
//!
//! Lines, fields and numbers are those of every text ([`TextLines`], [`mapping::text`]). A
//! recording is stricter: its header is the first line and has known names, fields are separated by
//! commas, times are in seconds, and no field is blank.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use mapping::text::{Dialect, Expected, Line, Separator};

use crate::{
    columns,
    error::{ParseError, Position, RecordingError},
    text_lines::{MAX_LINE_BYTES, TextLines},
    time,
};

const COMMA: Separator = Separator::Char(b',');

/// CSV file with its columns mapped to `C`. Reading ends after the first error.
pub(crate) struct Table<C> {
    path: PathBuf,
    lines: Lines,
    names: Vec<&'static str>,
    columns: C,
    dialect: Dialect,
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
        let header = match lines.next() {
            Ok(Some((line, text))) => columns::parse_header(&COMMA.fields(&text), line, known)
                .and_then(|names| Ok((columns(&names).map_err(|fault| (Position::line(line), fault))?, names))),
            Ok(None) => Err((Position::line(1), ParseError::Empty)),
            Err(malformed) => Err(malformed),
        };
        let path = path.to_owned();
        match header {
            Ok((columns, names)) => {
                let dialect = Dialect::new(COMMA);
                Ok(Self { path, lines, names, columns, dialect, rows: 0, is_finished: false })
            }
            Err((position, error)) => Err(RecordingError::Malformed { path, position, error }),
        }
    }

    /// Parses the next line with the function `row`. Returns `None` at the end of the file or after
    /// an error.
    pub(crate) fn next<T>(
        &mut self,
        row: impl FnOnce(&mut Fields<'_>, &C) -> Result<T, (Position, ParseError)>,
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

    /// Returns the number of the last line if it has been read and has no line end.
    pub(crate) fn unended_line(&self) -> Option<u64> {
        self.lines.unended_line
    }

    fn next_row<T>(
        &mut self,
        row: impl FnOnce(&mut Fields<'_>, &C) -> Result<T, (Position, ParseError)>,
    ) -> Result<Option<T>, (Position, ParseError)> {
        let Some((line, text)) = self.lines.next()? else {
            return if self.rows == 0 {
                Err((Position::line(self.lines.inner.count() + 1), ParseError::NoRows))
            } else {
                Ok(None)
            };
        };
        self.rows += 1;
        let (found, expected) = (COMMA.row_fields(&text, self.names.len()), self.names.len());
        let mut fields = Fields { fields: &found, names: &self.names, line, dialect: &mut self.dialect };
        if found.len() != expected {
            let position = fields.position(found.len().min(expected));
            return Err((position, ParseError::RowLength { found: found.len(), expected }));
        }
        row(&mut fields, &self.columns).map(Some)
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

/// Lines with names or values.
struct Lines {
    inner: TextLines<File>,
    unended_line: Option<u64>,
}

impl Lines {
    fn open(path: &Path) -> io::Result<Self> {
        // The file type is checked before opening, because opening a pipe blocks until it has a
        // writer.
        let file_type = fs::metadata(path)?.file_type();
        if !file_type.is_file() && !file_type.is_dir() {
            return Err(io::Error::new(io::ErrorKind::NotSeekable, "not a regular file (recordings are read twice)"));
        }
        Ok(Self { inner: TextLines::new(File::open(path)?)?, unended_line: None })
    }

    /// Reads the next line that is neither blank nor a comment. Returns its number and text, or
    /// `None` at the end.
    fn next(&mut self) -> Result<Option<(u64, String)>, (Position, ParseError)> {
        loop {
            let next_line = Position::line(self.inner.count() + 1);
            let line = match self.inner.next_line() {
                Ok(Some(line)) => line,
                Ok(None) => return Ok(None),
                Err(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => {
                    return Err((next_line, ParseError::Truncated));
                }
                Err(cause) => return Err((next_line, ParseError::Unreadable(cause))),
            };
            if line.is_too_long {
                let cause = io::Error::other(format!("longer than {MAX_LINE_BYTES} bytes"));
                return Err((next_line, ParseError::Unreadable(cause)));
            }
            match Line::parse(line.bytes) {
                Some(Line::Blank | Line::Comment(_)) => {}
                Some(Line::Content(text)) => {
                    self.unended_line = Some(line.number).filter(|_| !line.has_end);
                    return Ok(Some((line.number, text.to_owned())));
                }
                None => return Err((next_line, ParseError::invalid_value(line.bytes.trim_ascii(), "UTF-8 text"))),
            }
        }
    }
}

/// Fields of one line.
pub(crate) struct Fields<'a> {
    fields: &'a [&'a str],
    names: &'a [&'static str],
    line: u64,
    dialect: &'a mut Dialect,
}

impl<'a> Fields<'a> {
    pub(crate) fn numbers<const N: usize>(&mut self, indices: [usize; N]) -> Result<[f64; N], (Position, ParseError)> {
        let mut values = [0.0; N];
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.number(index)?;
        }
        Ok(values)
    }

    /// Returns the value of a column that holds 0 or 1.
    pub(crate) fn flag(&mut self, index: usize) -> Result<bool, (Position, ParseError)> {
        match self.number(index)? {
            0.0 => Ok(false),
            1.0 => Ok(true),
            _ => Err(self.invalid(index, "0 or 1")),
        }
    }

    /// Returns the time in a column, ns.
    pub(crate) fn time_ns(&self, index: usize) -> Result<i64, (Position, ParseError)> {
        mapping::text::time_ns(self.text(index), time::DIGITS).ok_or_else(|| self.invalid(index, time::EXPECTED))
    }

    fn number(&mut self, index: usize) -> Result<f64, (Position, ParseError)> {
        let text = self.text(index);
        let number = if text.is_empty() { Err(Expected::Number) } else { self.dialect.number(text) };
        number.map_err(|expected| self.invalid(index, expected.description()))
    }

    fn text(&self, index: usize) -> &'a str {
        self.fields.get(index).copied().unwrap_or_default()
    }

    fn invalid(&self, index: usize, expected: &'static str) -> (Position, ParseError) {
        (self.position(index), ParseError::invalid_value(self.text(index).as_bytes(), expected))
    }

    fn position(&self, index: usize) -> Position {
        Position::field(self.line, index, self.names.get(index).copied())
    }
}
