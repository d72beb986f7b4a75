//! Lines of a text file, for every reader of text.
//!
//! Input: text, plain or compressed with gzip or zstd.
//!
//! Output: the bytes of each line, with its number. A line ends with a newline or, if the start of
//! the file has none, with a carriage return.
//!
//! Failure: I/O errors and corrupt data. Lines are read in bounded memory: of a longer line, only
//! the first [`MAX_LINE_BYTES`] are kept.

use std::io::{self, BufRead, BufReader, Read};

use crate::unpacked::Unpacked;

/// Maximum length of a line, bytes.
pub const MAX_LINE_BYTES: usize = 1 << 16;
const BUFFER_BYTES: usize = 1 << 16;

/// Reader of lines.
pub struct TextLines<R: Read> {
    inner: BufReader<Unpacked<R>>,
    /// Last byte of a line.
    end: u8,
    /// Number of lines read.
    count: u64,
    text: Vec<u8>,
    /// Error of the first read, to be returned with the first line.
    error: Option<io::Error>,
}

/// Line of a file.
#[derive(Debug)]
pub struct TextLine<'a> {
    /// Number of the line, from 1.
    pub number: u64,
    /// Bytes of the line, at most [`MAX_LINE_BYTES`].
    pub bytes: &'a [u8],
    /// `true` if the line is longer than [`MAX_LINE_BYTES`].
    pub is_too_long: bool,
    /// `false` if the file ends before the end of the line.
    pub has_end: bool,
}

impl<R: Read> TextLines<R> {
    /// Creates a reader of a file.
    ///
    /// # Errors
    ///
    /// Returns an error if the first bytes of the file cannot be read.
    pub fn new(file: R) -> io::Result<Self> {
        let mut inner = BufReader::with_capacity(BUFFER_BYTES, Unpacked::new(file)?);
        let (end, error) = match inner.fill_buf() {
            Ok(start) if start.contains(&b'\r') && !start.contains(&b'\n') => (b'\r', None),
            Ok(_) => (b'\n', None),
            Err(error) => (b'\n', Some(error)),
        };
        Ok(Self { inner, end, count: 0, text: Vec::new(), error })
    }

    /// Returns the number of lines read.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the next line, or `None` at the end of the file.
    ///
    /// # Errors
    ///
    /// Returns an error if the line cannot be read. The part before the damage is lost.
    pub fn next_line(&mut self) -> io::Result<Option<TextLine<'_>>> {
        if let Some(error) = self.error.take() {
            return Err(error);
        }
        self.text.clear();
        let mut length = 0;
        let has_end = loop {
            let buffer = self.inner.fill_buf()?;
            let end = buffer.iter().position(|byte| *byte == self.end).map(|end| end + 1);
            let part = &buffer[..end.unwrap_or(buffer.len())];
            let room = MAX_LINE_BYTES.saturating_sub(self.text.len()).min(part.len());
            self.text.extend_from_slice(&part[..room]);
            let count = part.len();
            length += count;
            self.inner.consume(count);
            if end.is_some() || count == 0 {
                break end.is_some();
            }
        };
        if length == 0 {
            return Ok(None);
        }
        self.count += 1;
        let is_too_long = length > MAX_LINE_BYTES;
        Ok(Some(TextLine { number: self.count, bytes: &self.text, is_too_long, has_end }))
    }
}
