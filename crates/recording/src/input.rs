//! Splits the text of a recording into records, one per line.
//!
//! Input: bytes, decompressed if they begin with the gzip magic number.
//!
//! Output: the fields of each line that is not blank, with the line number.
//!
//! Failure: a corrupt stream and a line longer than [`MAX_LINE_BYTES`] are errors.

use crate::{
    error::{ParseError, Position},
    gzip::GzipReader,
};
use csv::{ByteRecord, ErrorKind, ReaderBuilder, Terminator};
use std::{
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

/// Magic number of gzip (RFC 1952, 2.3.1).
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
const BUFFER_BYTES: usize = 1 << 16;
const MAX_LINE_BYTES: usize = 1 << 16;

pub(crate) struct Lines {
    records: csv::Reader<BoundedLines<Box<dyn Read + Send>>>,
}

impl Lines {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        // The file type is checked before opening, because opening a pipe blocks until it has a
        // writer.
        let file_type = fs::metadata(path)?.file_type();
        if !file_type.is_file() && !file_type.is_dir() {
            return Err(io::Error::new(io::ErrorKind::NotSeekable, "not a regular file (recordings are read twice)"));
        }
        let mut file = File::open(path)?;
        let mut magic = Vec::new();
        file.by_ref().take(GZIP_MAGIC.len() as u64).read_to_end(&mut magic)?;
        let is_gzip = magic == GZIP_MAGIC;
        let bytes = io::Cursor::new(magic).chain(file);
        // `next` derives the number of a line from the number of the following one. The last line
        // therefore needs a newline as well.
        let final_newline = &b"\n"[..];
        let inner: Box<dyn Read + Send> = if is_gzip {
            Box::new(GzipReader::new(bytes).chain(final_newline))
        } else {
            Box::new(bytes.chain(final_newline))
        };
        let records = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            // A stray quote must not swallow the following lines. `unquoted` removes the quotes
            // around a field.
            .quoting(false)
            .terminator(Terminator::Any(b'\n'))
            .buffer_capacity(BUFFER_BYTES)
            .from_reader(BoundedLines { inner, line_bytes: 0 });
        Ok(Self { records })
    }

    /// Returns the line number of the read position, from 1.
    pub(crate) fn line(&self) -> u64 {
        self.records.position().line()
    }

    /// Reads the next line that is not blank and returns its number, or `None` at the end.
    pub(crate) fn next(&mut self, record: &mut ByteRecord) -> Result<Option<u64>, (Position, ParseError)> {
        loop {
            match self.records.read_byte_record(record) {
                Ok(false) => return Ok(None),
                Ok(true) if record.len() == 1 && record[0].trim_ascii().is_empty() => {}
                Ok(true) => return Ok(Some(self.line() - 1)),
                Err(error) => return Err((Position::line(self.line()), parse_error(error))),
            }
        }
    }
}

fn parse_error(error: csv::Error) -> ParseError {
    match error.into_kind() {
        ErrorKind::Io(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => ParseError::Truncated,
        ErrorKind::Io(cause) => ParseError::Unreadable(cause),
        other => ParseError::Unreadable(io::Error::other(format!("{other:?}"))),
    }
}

/// Returns the field without surrounding blanks and quotes.
pub(crate) fn unquoted(field: &[u8]) -> &[u8] {
    let field = field.trim_ascii();
    match field {
        [b'"', inner @ .., b'"'] => inner.trim_ascii(),
        _ => field,
    }
}

/// Reader that rejects overlong lines before a record buffer grows to hold them.
struct BoundedLines<R> {
    inner: R,
    line_bytes: usize,
}

impl<R: Read> Read for BoundedLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        let read = &buffer[..count];
        self.line_bytes = match read.iter().rposition(|&byte| byte == b'\n') {
            Some(end) => count - end - 1,
            None => self.line_bytes + count,
        };
        if self.line_bytes > MAX_LINE_BYTES {
            return Err(io::Error::other(format!("longer than {MAX_LINE_BYTES} bytes")));
        }
        Ok(count)
    }
}
