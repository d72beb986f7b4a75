//! One CSV file of whatever kind.
//!
//! Input: text, plain or gzip, with a header line; separated by commas, semicolons or tabs; numbers with a decimal point or a
//! decimal comma. Which of these is seen by the content. Output: its rows, field by field. Failure: the first line that is malformed
//! or does not fit into [`MAX_LINE_BYTES`], with its place.

use std::{
    cell::Cell,
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::{Path, PathBuf},
    rc::Rc,
};

use flate2::read::MultiGzDecoder;
use mapping::text::{fields, time_ns};

use crate::{
    ImportError,
    error::{Place, excerpt, opening},
};

const GZIP: &[u8] = b"\x1f\x8b";
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
const BUFFER_BYTES: usize = 1 << 16;
const MAX_LINE_BYTES: usize = 1 << 16;
/// The first that divides the header and the first row alike is it: a tab or a semicolon is hardly ever part of a name, and beside
/// them a comma is a decimal comma.
const SEPARATORS: [u8; 3] = [b'\t', b';', b','];

pub(crate) struct Text {
    path: PathBuf,
    lines: Lines,
    separator: u8,
    /// The columns, as the header names them.
    pub(crate) names: Vec<String>,
    /// The first row, which was looked at to see the separator.
    first: Option<(u64, Vec<u8>)>,
    /// What stands before the decimals of this file; `None` until the first are seen.
    point: Cell<Option<u8>>,
}

impl Text {
    /// Opens a file and reads its header. `read_bytes` grows with what is read of it.
    pub(crate) fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let mut lines = Lines::open(path, read_bytes)?;
        let at = |line| Place { line, column: None, name: None };
        let Some((line, mut header)) = lines.next()? else {
            return Err(malformed(path, at(1), "the end of the file", "the header line"));
        };
        if header.starts_with(BYTE_ORDER_MARK) {
            header.drain(..BYTE_ORDER_MARK.len());
        }
        let Some(first) = lines.next()? else {
            return Err(malformed(path, at(line + 1), "the end of the file", "a row"));
        };
        let width = |text: &[u8], separator| fields(text, separator).count();
        let divides = |separator: &u8| {
            let columns = width(&header, *separator);
            columns > 1 && columns == width(&first.1, *separator)
        };
        let separator = SEPARATORS.into_iter().find(divides);
        // Where none fits, the first row is told to be too long or too short.
        let by_header = || SEPARATORS.into_iter().find(|separator| width(&header, *separator) > 1);
        let separator = separator.or_else(by_header).unwrap_or(b',');
        let mut names = Vec::new();
        for (index, name) in fields(&header, separator).enumerate() {
            let place = || Place { line, column: Some(index + 1), name: None };
            let name = str::from_utf8(name).map_err(|_| malformed(path, place(), excerpt(name), "UTF-8 text"))?;
            names.push(name.to_owned());
        }
        Ok(Self { path: path.to_owned(), lines, separator, names, first: Some(first), point: Cell::new(None) })
    }

    /// The next row that is not blank; `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<Fields<'_>>, ImportError> {
        let next = match self.first.take() {
            Some(first) => Some(first),
            None => self.lines.next()?,
        };
        let Some((line, row)) = next else { return Ok(None) };
        let (found, expected) = (fields(&row, self.separator).count(), self.names.len());
        if found != expected {
            let index = found.min(expected);
            let place = Place { line, column: Some(index + 1), name: self.names.get(index).cloned() };
            let (found, expected) = (format!("{found} fields"), format!("{expected} as in the header"));
            return Err(malformed(&self.path, place, found, expected));
        }
        Ok(Some(Fields { text: self, line, row }))
    }
}

fn malformed(path: &Path, place: Place, found: impl Into<String>, expected: impl Into<String>) -> ImportError {
    ImportError::Malformed {
        path: path.to_owned(),
        place: place.into(),
        found: found.into(),
        expected: expected.into(),
    }
}

/// A row, taken apart.
pub(crate) struct Fields<'a> {
    text: &'a Text,
    line: u64,
    row: Vec<u8>,
}

impl Fields<'_> {
    /// The numbers at these indices; `None` where one of them is blank or nan: no sample.
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

    /// The time at this index, ns, of which `digits` are the decimals of its unit.
    pub(crate) fn time_ns(&self, index: usize, digits: usize) -> Result<i64, ImportError> {
        let unit = match digits {
            9 => "a time in s",
            6 => "a time in ms",
            3 => "a time in us",
            _ => "a time in ns",
        };
        let text = self.decimal(index, unit)?;
        time_ns(&text, digits)
            .ok_or_else(|| self.malformed(index, &format!("{unit}, less than 9e9 s; say another with --units")))
    }

    /// The field at an index with a decimal point, as far as it is a number.
    fn decimal(&self, index: usize, expected: &str) -> Result<String, ImportError> {
        let field = fields(&self.row, self.text.separator).nth(index).unwrap_or_default();
        let mut text = str::from_utf8(field).map_err(|_| self.malformed(index, "UTF-8 text"))?.to_owned();
        let Some(point) = text.bytes().find(|byte| matches!(byte, b'.' | b',')) else { return Ok(text) };
        match self.text.point.replace(self.text.point.get().or(Some(point))) {
            Some(b'.') if point == b',' => {
                return Err(self.malformed(index, &format!("{expected} with a decimal point, as before")));
            }
            Some(b',') if point == b'.' => {
                return Err(self.malformed(index, &format!("{expected} with a decimal comma, as before")));
            }
            _ => {}
        }
        // More than one, or both, are none of a number: it is refused where it is read.
        if point == b',' && !text.contains('.') {
            text = text.replacen(',', ".", 1);
        }
        Ok(text)
    }

    fn malformed(&self, index: usize, expected: &str) -> ImportError {
        let field = fields(&self.row, self.text.separator).nth(index).unwrap_or_default();
        let place = Place { line: self.line, column: Some(index + 1), name: self.text.names.get(index).cloned() };
        malformed(&self.text.path, place, excerpt(field), expected)
    }
}

/// The lines of a file that are neither blank nor remarks.
struct Lines {
    path: PathBuf,
    inner: Box<dyn BufRead>,
    line: u64,
}

impl Lines {
    fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> Result<Self, ImportError> {
        let failed = |cause| opening(path, cause);
        let file = Counted::new(File::open(path).map_err(failed)?, read_bytes);
        let mut file = BufReader::with_capacity(BUFFER_BYTES, file);
        let inner: Box<dyn BufRead> = if file.fill_buf().map_err(failed)?.starts_with(GZIP) {
            Box::new(BufReader::with_capacity(BUFFER_BYTES, MultiGzDecoder::new(file)))
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
            let at = || Place { line: self.line, column: None, name: None };
            let read = self.inner.by_ref().take(MAX_LINE_BYTES as u64 + 1).read_until(b'\n', &mut text);
            match read {
                Ok(0) => return Ok(None),
                Ok(length) if length > MAX_LINE_BYTES => {
                    let found = format!("a line of more than {MAX_LINE_BYTES} bytes");
                    return Err(malformed(&self.path, at(), found, "a readable line"));
                }
                Ok(_) => {}
                Err(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => {
                    let found = "the end of the file inside the gzip stream";
                    return Err(malformed(&self.path, at(), found, "the rest of it; copy the file again"));
                }
                Err(cause) => return Err(malformed(&self.path, at(), cause.to_string(), "a readable line")),
            }
            let trimmed = text.trim_ascii();
            // Excel is told the separator so; it is seen without.
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

/// A file that counts what is read of it.
pub(crate) struct Counted {
    inner: File,
    read_bytes: Rc<Cell<u64>>,
}

impl Counted {
    pub(crate) fn new(inner: File, read_bytes: &Rc<Cell<u64>>) -> Self {
        Self { inner, read_bytes: read_bytes.clone() }
    }
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.read_bytes.set(self.read_bytes.get() + count as u64);
        Ok(count)
    }
}
