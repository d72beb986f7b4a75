//! Reads a single file of text with numbers, in any dialect.
//!
//! Input: text, plain or compressed ([`recording::TextLines`]). The column names are in the line
//! before the first row, which may be a comment; if there are no names, the columns are those of a
//! live stream. The rules for comments, separators, numbers and times are those of live streams
//! ([`mapping::text`]).
//!
//! Output: records.
//!
//! Failure: a malformed line yields an error with its position, and reading continues with the next
//! line. If the file is damaged, reading ends at the damage ([`CsvReader::into_notes`]).

use std::{
    cell::Cell,
    fs::File,
    io::{self, Read},
    path::{Path, PathBuf},
    rc::Rc,
};

use foreign::ForeignText;
use mapping::{
    names_with_units,
    text::{Dialect, Expected, Line, Separator, Time, is_row, unnamed_columns},
};
use recording::{MAX_LINE_BYTES, TextLine, TextLines};

use crate::{
    ImportError, Note,
    error::{TextPosition, excerpt, open_error},
};

/// Maximum number of lines before the first row.
const MAX_HEADER_LINES: usize = 256;

pub(crate) struct CsvReader {
    path: PathBuf,
    lines: Lines,
    /// Column names of the header.
    pub(crate) names: Vec<ForeignText>,
    /// First row, read in advance to detect the dialect.
    first_row: Option<(u64, String)>,
    dialect: Cell<Dialect>,
}

impl CsvReader {
    /// Opens a file and reads its column names.
    ///
    /// The number of bytes read from the file is added to `read_bytes`.
    pub(crate) fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let mut lines = Lines::open(path, read_bytes)?;
        let (header, first) = read_start(path, &mut lines)?;
        lines.is_before_rows = false;
        let separator = match &header {
            Some(Header { names, .. }) => {
                Separator::common(&[names, &first.1]).unwrap_or_else(|| Separator::of_line(names))
            }
            None => Separator::ALL
                .into_iter()
                .find(|separator| unnamed_columns(separator.fields(&first.1).len()).is_some())
                .unwrap_or_else(|| Separator::of_line(&first.1)),
        };
        let names = match &header {
            Some(Header { names, units }) => {
                let names = separator.fields(names);
                let with_units = units.as_ref().and_then(|units| names_with_units(&names, &separator.fields(units)));
                match with_units {
                    Some(names) => names.into_iter().map(ForeignText::from).collect(),
                    None => names.into_iter().map(ForeignText::from).collect(),
                }
            }
            None => {
                let count = separator.fields(&first.1).len();
                let numbered = || (1..=count).map(|number| ForeignText::from(number.to_string())).collect();
                unnamed_columns(count)
                    .map_or_else(numbered, |names| names.iter().copied().map(ForeignText::from).collect())
            }
        };
        let dialect = Cell::new(Dialect::new(separator));
        Ok(Self { path: path.to_owned(), lines, names, first_row: Some(first), dialect })
    }

    /// Returns the next row, or `None` at the end of the file.
    pub(crate) fn next(&mut self) -> Result<Option<CsvRecord<'_>>, ImportError> {
        let next = match self.first_row.take() {
            Some(first) => Some(first),
            None => loop {
                match self.lines.next()? {
                    Some((_, OwnedLine::Comment(_))) => {}
                    Some((line, OwnedLine::Content(row))) => break Some((line, row)),
                    None => break None,
                }
            },
        };
        let Some((line, row)) = next else { return Ok(None) };
        let expected = self.names.len();
        let found = self.dialect.get().separator.row_fields(&row, expected).len();
        if found != expected {
            let index = found.min(expected);
            let position = TextPosition { line, column: Some(index + 1), name: self.names.get(index).cloned() };
            let (found, expected) = (format!("{found} fields"), format!("{expected} as in the header"));
            return Err(malformed(&self.path, position, found, expected));
        }
        Ok(Some(CsvRecord { reader: self, line, row }))
    }

    /// Returns the notes on the file once it has been read to its end.
    ///
    /// # Errors
    ///
    /// Returns the error of the first malformed row if no row is valid.
    pub(crate) fn into_notes(self, counts: RowCounts) -> Result<Vec<Note>, ImportError> {
        let mut notes = Vec::new();
        if let Some(found) = self.lines.damage {
            let file = foreign::path(Path::new(self.path.file_name().unwrap_or_default()));
            notes.push(Note::DamagedFile { file, found });
        }
        // The last number of a row without a line end may be truncated.
        notes.extend(self.lines.unended_row.map(|line| Note::UnendedRow { line }));
        match counts.first_error {
            Some(error) if counts.valid == 0 => return Err(error),
            Some(ImportError::Malformed { position, found, expected, .. }) => {
                let TextPosition { line, .. } = *position;
                notes.push(Note::MalformedRows { count: counts.malformed, line, found, expected });
            }
            _ => {}
        }
        Ok(notes)
    }
}

/// Counts of valid and malformed rows, and the error of the first malformed one.
#[derive(Default)]
pub(crate) struct RowCounts {
    valid: u64,
    pub(crate) malformed: u64,
    first_error: Option<ImportError>,
}

impl RowCounts {
    pub(crate) fn add_valid(&mut self) {
        self.valid += 1;
    }

    pub(crate) fn add_malformed(&mut self, error: ImportError) {
        self.malformed += 1;
        self.first_error.get_or_insert(error);
    }
}

/// Lines that describe the columns.
struct Header {
    names: String,
    /// Line with the units of the columns, if it follows the names.
    units: Option<String>,
}

/// Column names of a file, and its first row.
type Start = (Option<Header>, (u64, String));

/// Reads the lines up to the first row. Returns the column names, if present, and the first row.
///
/// The names are in the last line before the first row that is not a comment. If that line and the
/// row differ in their number of columns, the names are in the last comment that has as many
/// columns as the row, if any. The names may be followed by a line with their units. If no line is
/// a row, the first two lines are used.
fn read_start(path: &Path, lines: &mut Lines) -> Result<Start, ImportError> {
    let line_position = |line| TextPosition { line, column: None, name: None };
    let (mut comments, mut headers, mut error) = (Vec::new(), Vec::new(), None);
    let mut first_two: Vec<(u64, String)> = Vec::new();
    for _ in 0..MAX_HEADER_LINES {
        match lines.next() {
            Ok(None) => break,
            Ok(Some((_, OwnedLine::Comment(text)))) => comments.push(text),
            Ok(Some((line, OwnedLine::Content(text)))) if is_row(&text) => {
                let fits = |names: &String| Separator::common(&[names, &text]).is_some();
                let last_fitting = |lines: &[String]| {
                    let last = lines.iter().rposition(fits)?;
                    let separator = Separator::common(&[&lines[last], &text])?;
                    // If this line contains the units, the names are in the line before.
                    let before = last.checked_sub(1).filter(|before| {
                        let [names, units] = [*before, last].map(|index| separator.fields(&lines[index]));
                        names_with_units(&names, &units).is_some()
                    });
                    Some(before.map_or((last, None), |before| (before, Some(last))))
                };
                let header = |lines: &[String], (names, units): (usize, Option<usize>)| Header {
                    names: lines[names].clone(),
                    units: units.map(|units| lines[units].clone()),
                };
                let is_header = |found: &(usize, Option<usize>)| found.1.unwrap_or(found.0) + 1 == headers.len();
                let names = last_fitting(&headers).filter(is_header).map(|found| header(&headers, found));
                let names = names.or_else(|| last_fitting(&comments).map(|found| header(&comments, found)));
                let last = || headers.last().map(|names| Header { names: names.clone(), units: None });
                return Ok((names.or_else(last), (line, text)));
            }
            Ok(Some((line, OwnedLine::Content(text)))) => {
                headers.push(text.clone());
                if first_two.len() < 2 {
                    first_two.push((line, text));
                }
            }
            Err(found) => error = error.or(Some(found)),
        }
    }
    let mut first_two = first_two.into_iter();
    match (first_two.next(), first_two.next(), error) {
        (Some((_, names)), Some(row), _) => Ok((Some(Header { names, units: None }), row)),
        (_, _, Some(error)) => Err(error),
        (Some((line, _)), None, None) => Err(malformed(path, line_position(line + 1), "the end of the file", "a row")),
        (None, _, None) => Err(malformed(path, line_position(1), "the end of the file", "the header line")),
    }
}

fn malformed(
    path: &Path,
    position: TextPosition,
    found: impl Into<ForeignText>,
    expected: impl Into<String>,
) -> ImportError {
    ImportError::Malformed {
        path: path.to_owned(),
        position: position.into(),
        found: found.into(),
        expected: expected.into(),
    }
}

/// Row of the file.
pub(crate) struct CsvRecord<'a> {
    reader: &'a CsvReader,
    line: u64,
    row: String,
}

impl CsvRecord<'_> {
    /// Returns the numbers in these columns; `None` if a number is blank or NaN.
    pub(crate) fn numbers<const N: usize>(&self, indices: [usize; N]) -> Result<Option<[f64; N]>, ImportError> {
        let mut values = [f64::NAN; N];
        let fields = self.fields();
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.parse(&fields, index, |dialect, field| dialect.number(field))?;
        }
        Ok((!values.iter().any(|value| value.is_nan())).then_some(values))
    }

    /// Returns the value of a column that holds 0 or 1.
    pub(crate) fn flag(&self, index: usize) -> Result<bool, ImportError> {
        match self.parse(&self.fields(), index, |dialect, field| dialect.number(field))? {
            0.0 => Ok(false),
            1.0 => Ok(true),
            _ => {
                let name = self.reader.names.get(index).cloned();
                let position = TextPosition { line: self.line, column: Some(index + 1), name };
                let field = self.fields().get(index).copied().unwrap_or_default().to_owned();
                Err(malformed(&self.reader.path, position, excerpt(field.as_bytes()), "0 or 1"))
            }
        }
    }

    /// Returns the time in a column.
    ///
    /// `digits` is the number of decimal places that a time in the column's unit needs to resolve 1
    /// ns: 9 for seconds, 0 for nanoseconds.
    pub(crate) fn time(&self, index: usize, digits: usize) -> Result<Time, ImportError> {
        let time = |dialect: &mut Dialect, field: &str| dialect.time(field, digits)?.ok_or(Expected::TimeText);
        self.parse(&self.fields(), index, time).map_err(|error| match error {
            ImportError::Malformed { path, position, found, expected } if expected == Expected::Time.description() => {
                let unit = match digits {
                    9 => "s",
                    6 => "ms",
                    3 => "us",
                    _ => "ns",
                };
                let expected = format!("a time in {unit}, {expected}");
                ImportError::Malformed { path, position, found, expected }
            }
            error => error,
        })
    }

    /// Returns `true` if a column holds a date or a time of day, which has no unit.
    pub(crate) fn has_clock_time(&self, index: usize) -> bool {
        let mut dialect = self.reader.dialect.get();
        let time = self.fields().get(index).map(|field| dialect.time(field, 0));
        matches!(time, Some(Ok(Some(Time::Calendar(_) | Time::OfDay(_))) | Err(Expected::DateOrder)))
    }

    fn fields(&self) -> Vec<&str> {
        self.reader.dialect.get().separator.fields(&self.row)
    }

    fn parse<T>(
        &self,
        fields: &[&str],
        index: usize,
        parse: impl FnOnce(&mut Dialect, &str) -> Result<T, Expected>,
    ) -> Result<T, ImportError> {
        let mut dialect = self.reader.dialect.get();
        let field = fields.get(index).copied().unwrap_or_default();
        let value = parse(&mut dialect, field).map_err(|expected| {
            let name = self.reader.names.get(index).cloned();
            let position = TextPosition { line: self.line, column: Some(index + 1), name };
            malformed(&self.reader.path, position, excerpt(field.as_bytes()), expected.description())
        })?;
        self.reader.dialect.set(dialect);
        Ok(value)
    }
}

/// Line that is not blank.
enum OwnedLine {
    Comment(String),
    Content(String),
}

/// Lines of a file, without blank ones.
struct Lines {
    path: PathBuf,
    inner: TextLines<CountingReader>,
    /// `true` until the first row. Column names may then be in Latin-1, for a unit such as °/s.
    is_before_rows: bool,
    /// Description of the damage at which reading ended.
    damage: Option<ForeignText>,
    /// Number of the last line, if it is a row without a line end.
    unended_row: Option<u64>,
}

impl Lines {
    fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let file = File::open(path).and_then(|file| TextLines::new(CountingReader::new(file, read_bytes)));
        let inner = file.map_err(|cause| open_error(path, cause))?;
        Ok(Self { path: path.to_owned(), inner, is_before_rows: true, damage: None, unended_row: None })
    }

    /// Returns the next line, or `None` at the end of the file or at damage in a compressed file.
    /// After an error, the next call continues with the next line.
    fn next(&mut self) -> Result<Option<(u64, OwnedLine)>, ImportError> {
        while self.damage.is_none() {
            let next_number = self.inner.count() + 1;
            let TextLine { number, bytes, is_too_long, has_end } = match self.inner.next_line() {
                Ok(Some(line)) => line,
                Ok(None) => return Ok(None),
                Err(cause) => {
                    let found = match cause.kind() {
                        io::ErrorKind::UnexpectedEof => "the end of the file inside the compressed data".into(),
                        _ => cause.to_string(),
                    };
                    self.damage = Some(format!("line {next_number}: {found}").into());
                    // The part of the line before the damage has no end.
                    return Ok(None);
                }
            };
            let position = TextPosition { line: number, column: None, name: None };
            if is_too_long {
                let found = format!("a line of more than {MAX_LINE_BYTES} bytes");
                return Err(malformed(&self.path, position, found, "a readable line"));
            }
            // A first line `sep=…` specifies the separator for Excel. It is skipped, because the
            // separator is detected from the content.
            if number == 1 && bytes.trim_ascii().starts_with(b"sep=") {
                continue;
            }
            let is_names = |text: &String| Line::parse(text.as_bytes()).is_some() && !is_row(text);
            let latin_1 = || Some(bytes.iter().map(|byte| char::from(*byte)).collect::<String>()).filter(is_names);
            let names = if self.is_before_rows && str::from_utf8(bytes).is_err() { latin_1() } else { None };
            match Line::parse(names.as_ref().map_or(bytes, |names| names.as_bytes())) {
                Some(Line::Blank) => {}
                Some(Line::Comment(comment)) => return Ok(Some((number, OwnedLine::Comment(comment.to_owned())))),
                Some(Line::Content(line)) => {
                    self.unended_row = Some(number).filter(|_| !has_end);
                    return Ok(Some((number, OwnedLine::Content(line.to_owned()))));
                }
                None => return Err(malformed(&self.path, position, excerpt(bytes), "UTF-8 text")),
            }
        }
        Ok(None)
    }
}

/// File reader that counts the bytes read.
pub(crate) struct CountingReader {
    inner: File,
    read_bytes: Rc<Cell<u64>>,
}

impl CountingReader {
    pub(crate) fn new(inner: File, read_bytes: &Rc<Cell<u64>>) -> Self {
        Self { inner, read_bytes: read_bytes.clone() }
    }
}

impl Read for CountingReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.read_bytes.set(self.read_bytes.get() + count as u64);
        Ok(count)
    }
}
