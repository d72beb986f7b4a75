//! Reads a single CSV file in any dialect.
//!
//! Input: text, plain or gzip, with a header line. Columns are separated by commas, semicolons or
//! tabs, and numbers have a decimal point or a decimal comma. The dialect is detected from the
//! content.
//!
//! Output: records.
//!
//! Failure: the first line that is malformed or longer than [`MAX_LINE_BYTES`] is reported as an
//! error with its position.

use std::{
    cell::Cell,
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::{Path, PathBuf},
    rc::Rc,
};

use foreign::ForeignText;
use mapping::text::{fields, time_ns};
use recording::GzipReader;

use crate::{
    ImportError,
    error::{TextPosition, excerpt, open_error},
};

const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
const BUFFER_BYTES: usize = 1 << 16;
const MAX_LINE_BYTES: usize = 1 << 16;
/// Separators in order of preference.
///
/// The first one that splits the header and the first row into the same number of columns is used.
/// Tabs and semicolons come first because they rarely occur in names, and because a comma in a file
/// with one of these separators is a decimal comma.
const SEPARATORS: [u8; 3] = [b'\t', b';', b','];

pub(crate) struct CsvReader {
    path: PathBuf,
    lines: Lines,
    separator: u8,
    /// Column names of the header.
    pub(crate) names: Vec<ForeignText>,
    /// First row, read in advance to detect the separator.
    first_row: Option<(u64, Vec<u8>)>,
    /// Decimal mark of the file; `None` until the first decimal fraction has been read.
    decimal_mark: Cell<Option<u8>>,
}

impl CsvReader {
    /// Opens a file and reads its header.
    ///
    /// The number of bytes read from the file is added to `read_bytes`.
    pub(crate) fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let mut lines = Lines::open(path, read_bytes)?;
        let line_position = |line| TextPosition { line, column: None, name: None };
        let Some((line, mut header)) = lines.next()? else {
            return Err(malformed(path, line_position(1), "the end of the file", "the header line"));
        };
        if header.starts_with(BYTE_ORDER_MARK) {
            header.drain(..BYTE_ORDER_MARK.len());
        }
        let Some(first) = lines.next()? else {
            return Err(malformed(path, line_position(line + 1), "the end of the file", "a row"));
        };
        let width = |text: &[u8], separator| fields(text, separator).count();
        let separates = |separator: &u8| {
            let columns = width(&header, *separator);
            columns > 1 && columns == width(&first.1, *separator)
        };
        let separator = SEPARATORS.into_iter().find(separates);
        // If no separator fits, the wrong number of columns is reported later, when the first row
        // is read.
        let header_separator = || SEPARATORS.into_iter().find(|separator| width(&header, *separator) > 1);
        let separator = separator.or_else(header_separator).unwrap_or(b',');
        let mut names = Vec::new();
        for (index, name) in fields(&header, separator).enumerate() {
            let place = || TextPosition { line, column: Some(index + 1), name: None };
            let name = str::from_utf8(name).map_err(|_| malformed(path, place(), excerpt(name), "UTF-8 text"))?;
            names.push(name.into());
        }
        Ok(Self {
            path: path.to_owned(),
            lines,
            separator,
            names,
            first_row: Some(first),
            decimal_mark: Cell::new(None),
        })
    }

    /// Returns the next row that is not blank, or `None` at the end of the file.
    pub(crate) fn next(&mut self) -> Result<Option<CsvRecord<'_>>, ImportError> {
        let next = match self.first_row.take() {
            Some(first) => Some(first),
            None => self.lines.next()?,
        };
        let Some((line, row)) = next else { return Ok(None) };
        let (found, expected) = (fields(&row, self.separator).count(), self.names.len());
        if found != expected {
            let index = found.min(expected);
            let position = TextPosition { line, column: Some(index + 1), name: self.names.get(index).cloned() };
            let (found, expected) = (format!("{found} fields"), format!("{expected} as in the header"));
            return Err(malformed(&self.path, position, found, expected));
        }
        Ok(Some(CsvRecord { reader: self, line, row }))
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
    row: Vec<u8>,
}

impl CsvRecord<'_> {
    /// Returns the numbers in these columns; `None` if one of them is blank or NaN.
    pub(crate) fn numbers<const N: usize>(&self, indices: [usize; N]) -> Result<Option<[f64; N]>, ImportError> {
        let mut values = [f64::NAN; N];
        for (value, index) in values.iter_mut().zip(indices) {
            let text = self.decimal(index, "a number")?;
            if !text.is_empty() {
                *value = text.parse().map_err(|_| self.malformed(index, "a number"))?;
            }
        }
        Ok((!values.iter().any(|value| value.is_nan())).then_some(values))
    }

    /// Returns the time in a column, ns.
    ///
    /// `digits` is the number of decimal places of the column's unit that correspond to 1 ns: 9 for
    /// seconds, 0 for nanoseconds.
    pub(crate) fn time_ns(&self, index: usize, digits: usize) -> Result<i64, ImportError> {
        let unit = match digits {
            9 => "a time in s",
            6 => "a time in ms",
            3 => "a time in us",
            _ => "a time in ns",
        };
        let text = self.decimal(index, unit)?;
        time_ns(&text, digits)
            .ok_or_else(|| self.malformed(index, &format!("{unit}, less than 9e9 s; set another unit with --units")))
    }

    /// Returns the text of a column with its decimal comma replaced by a point.
    fn decimal(&self, index: usize, expected: &str) -> Result<String, ImportError> {
        let field = fields(&self.row, self.reader.separator).nth(index).unwrap_or_default();
        let mut text = str::from_utf8(field).map_err(|_| self.malformed(index, "UTF-8 text"))?.to_owned();
        let Some(mark) = text.bytes().find(|byte| matches!(byte, b'.' | b',')) else { return Ok(text) };
        match self.reader.decimal_mark.replace(self.reader.decimal_mark.get().or(Some(mark))) {
            Some(b'.') if mark == b',' => {
                return Err(self.malformed(index, &format!("{expected} with a decimal point, as before")));
            }
            Some(b',') if mark == b'.' => {
                return Err(self.malformed(index, &format!("{expected} with a decimal comma, as before")));
            }
            _ => {}
        }
        // Text with several decimal marks is not a number and is rejected by the caller.
        if mark == b',' && !text.contains('.') {
            text = text.replacen(',', ".", 1);
        }
        Ok(text)
    }

    fn malformed(&self, index: usize, expected: &str) -> ImportError {
        let field = fields(&self.row, self.reader.separator).nth(index).unwrap_or_default();
        let position =
            TextPosition { line: self.line, column: Some(index + 1), name: self.reader.names.get(index).cloned() };
        malformed(&self.reader.path, position, excerpt(field), expected)
    }
}

/// Lines of a file, excluding blank lines and comments.
struct Lines {
    path: PathBuf,
    inner: Box<dyn BufRead>,
    line: u64,
}

impl Lines {
    fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let failed = |cause| open_error(path, cause);
        let file = CountingReader::new(File::open(path).map_err(failed)?, read_bytes);
        let mut file = BufReader::with_capacity(BUFFER_BYTES, file);
        let inner: Box<dyn BufRead> = if file.fill_buf().map_err(failed)?.starts_with(GZIP_MAGIC) {
            Box::new(BufReader::with_capacity(BUFFER_BYTES, GzipReader::new(file)))
        } else {
            Box::new(file)
        };
        Ok(Self { path: path.to_owned(), inner, line: 0 })
    }

    fn next(&mut self) -> Result<Option<(u64, Vec<u8>)>, ImportError> {
        let mut text = Vec::new();
        loop {
            self.line += 1;
            text.clear();
            let line_position = || TextPosition { line: self.line, column: None, name: None };
            let read = self.inner.by_ref().take(MAX_LINE_BYTES as u64 + 1).read_until(b'\n', &mut text);
            match read {
                Ok(0) => return Ok(None),
                Ok(length) if length > MAX_LINE_BYTES => {
                    let found = format!("a line of more than {MAX_LINE_BYTES} bytes");
                    return Err(malformed(&self.path, line_position(), found, "a readable line"));
                }
                Ok(_) => {}
                Err(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => {
                    let found = "the end of the file inside the gzip stream";
                    return Err(malformed(
                        &self.path,
                        line_position(),
                        found,
                        "a complete stream; copy the file again",
                    ));
                }
                Err(cause) => return Err(malformed(&self.path, line_position(), cause.to_string(), "a readable line")),
            }
            let trimmed = text.trim_ascii();
            // A first line `sep=…` specifies the separator for Excel. It is skipped, because the
            // separator is detected from the content.
            if trimmed.is_empty() || trimmed.starts_with(b"#") || (self.line == 1 && trimmed.starts_with(b"sep=")) {
                continue;
            }
            while text.last().is_some_and(|end| matches!(end, b'\r' | b'\n')) {
                text.pop();
            }
            return Ok(Some((self.line, text)));
        }
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
