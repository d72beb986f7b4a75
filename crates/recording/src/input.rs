//! The text of a recording: its records, by line.
//!
//! Input: bytes, gzip if they begin with its magic number. Output: the fields of every line that is not blank, with the
//! line's number. Failure: a damaged stream, or a line that would not fit into [`LINE_MAX_BYTES`].

use crate::error::{Fault, Position};
use csv::{ByteRecord, ErrorKind, ReaderBuilder, Terminator};
use flate2::read::MultiGzDecoder;
use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

/// RFC 1952, 2.3.1.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
const BUFFER_BYTES: usize = 1 << 16;
const LINE_MAX_BYTES: usize = 1 << 16;

pub(crate) struct Lines {
    records: csv::Reader<BoundedLines<Box<dyn Read + Send>>>,
}

impl Lines {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let kind = file.metadata()?.file_type();
        if !kind.is_file() && !kind.is_dir() {
            return Err(io::Error::new(io::ErrorKind::NotSeekable, "it is a pipe or a device, and is read twice"));
        }
        let mut start = Vec::new();
        file.by_ref().take(GZIP_MAGIC.len() as u64).read_to_end(&mut start)?;
        let gzip = start == GZIP_MAGIC;
        let bytes = io::Cursor::new(start).chain(file);
        // The last line ends like the others: `next` counts on it.
        let end = &b"\n"[..];
        let inner: Box<dyn Read + Send> =
            if gzip { Box::new(MultiGzDecoder::new(bytes).chain(end)) } else { Box::new(bytes.chain(end)) };
        let records = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            // A stray quote must not swallow the lines after it; `unquoted` takes off those around a field.
            .quoting(false)
            .terminator(Terminator::Any(b'\n'))
            .buffer_capacity(BUFFER_BYTES)
            .from_reader(BoundedLines { inner, line_bytes: 0 });
        Ok(Self { records })
    }

    /// The line now being read, from 1.
    pub(crate) fn line(&self) -> u64 {
        self.records.position().line()
    }

    /// The next line that is not blank and its number; `None` at the end.
    pub(crate) fn next(&mut self, record: &mut ByteRecord) -> Result<Option<u64>, (Position, Fault)> {
        loop {
            match self.records.read_byte_record(record) {
                Ok(false) => return Ok(None),
                Ok(true) if record.len() == 1 && record[0].trim_ascii().is_empty() => {}
                Ok(true) => return Ok(Some(self.line() - 1)),
                Err(error) => return Err((Position::line(self.line()), fault(error))),
            }
        }
    }
}

fn fault(error: csv::Error) -> Fault {
    match error.into_kind() {
        ErrorKind::Io(cause) if cause.kind() == io::ErrorKind::UnexpectedEof => Fault::Truncated,
        ErrorKind::Io(cause) => Fault::Unreadable(cause),
        other => Fault::Unreadable(io::Error::other(format!("{other:?}"))),
    }
}

/// A field without the blanks and the quotes around it.
pub(crate) fn unquoted(field: &[u8]) -> &[u8] {
    let field = field.trim_ascii();
    match field {
        [b'"', inner @ .., b'"'] => inner.trim_ascii(),
        _ => field,
    }
}

/// Refuses a line that never ends, before a record grows to hold it.
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
        if self.line_bytes > LINE_MAX_BYTES {
            return Err(io::Error::other(format!("a line of more than {LINE_MAX_BYTES} bytes")));
        }
        Ok(count)
    }
}
