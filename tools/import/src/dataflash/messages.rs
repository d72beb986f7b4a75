//! Reads the messages of a DataFlash log.
//!
//! Input: an ArduPilot log, which describes the layout of its messages in FMT messages.
//!
//! Output: the messages of the supported types.
//!
//! Memory: one buffer.
//!
//! Failure: only file errors. Bytes that are not part of a message are skipped and counted.
//! Messages have no checksum, so a message is accepted only if another message, the end of the log
//! or a long damaged part follows it.
//!
//! The available parser crate is not used, because it stops silently after 256 consecutive faults,
//! does not report skipped bytes, and allocates memory for each field of each message.

use std::{
    cell::Cell,
    fs::File,
    io::{self, Read},
    path::Path,
    rc::Rc,
};

use super::{field::Field, fields::Layout};
use crate::csv_reader::CountingReader;

const MESSAGE_MAGIC: [u8; 2] = [0xa3, 0x95];
/// Length of the magic number and the type, bytes.
const HEADER_BYTES: usize = 3;
/// Type of the FMT messages, which describe the layout of all message types.
const FMT: u8 = 0x80;
const FMT_BYTES: usize = 89;
const BUFFER_BYTES: usize = 1 << 16;
/// Number of bytes that are searched for the start of the next message.
const SEARCHED_BYTES: usize = 1 << 12;

/// Length and layout of a message type.
pub(super) struct Format {
    length_bytes: usize,
    /// Layout of the fields; `None` if the type is not supported.
    layout: Option<Layout>,
}

/// Buffered reader of messages.
pub(super) struct MessageReader {
    file: CountingReader,
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    formats: [Option<Format>; 256],
    /// Number of bytes skipped because they do not belong to a message.
    pub(super) skipped_bytes: u64,
}

impl MessageReader {
    pub(super) fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> io::Result<Self> {
        let mut formats = [const { None }; 256];
        formats[usize::from(FMT)] = Some(Format { length_bytes: FMT_BYTES, layout: None });
        Ok(Self {
            file: CountingReader::new(File::open(path)?, read_bytes),
            buffer: vec![0; BUFFER_BYTES].into(),
            start: 0,
            end: 0,
            formats,
            skipped_bytes: 0,
        })
    }

    /// Returns the next message of a supported type with its layout, or `None` at the end of the
    /// log.
    pub(super) fn next(&mut self) -> io::Result<Option<(&Layout, &[u8])>> {
        loop {
            let available = self.fill(HEADER_BYTES)?;
            if available < HEADER_BYTES {
                self.skip(available);
                return Ok(None);
            }
            let kind = self.buffer[self.start + 2];
            let format = self.formats[usize::from(kind)].as_ref();
            let has_magic = self.buffer[self.start..].starts_with(&MESSAGE_MAGIC);
            let Some(length_bytes) = format.filter(|_| has_magic).map(|format| format.length_bytes) else {
                self.skip(1);
                continue;
            };
            let available = self.fill(length_bytes + MESSAGE_MAGIC.len())?;
            let next = &self.buffer[self.start..self.end][length_bytes.min(available)..];
            let is_followed = next.len() < MESSAGE_MAGIC.len() || next.starts_with(&MESSAGE_MAGIC);
            if available < length_bytes || !(is_followed || self.is_last(length_bytes)?) {
                self.skip(1);
                continue;
            }
            let message = self.start..self.start + length_bytes;
            self.start = message.end;
            if kind == FMT {
                self.register_format(message.start);
            } else if self.formats[usize::from(kind)].as_ref().is_some_and(|format| format.layout.is_some()) {
                let layout = self.formats[usize::from(kind)].as_ref().and_then(|format| format.layout.as_ref());
                return Ok(layout.map(|layout| (layout, &self.buffer[message])));
            }
        }
    }

    /// Returns `true` if the next `length_bytes` bytes are the last message before a damaged part.
    ///
    /// This is the case if no message starts within [`SEARCHED_BYTES`] after them.
    fn is_last(&mut self, length_bytes: usize) -> io::Result<bool> {
        self.fill(length_bytes + SEARCHED_BYTES)?;
        let rest = &self.buffer[self.start..self.end][length_bytes..];
        Ok(!rest.windows(MESSAGE_MAGIC.len()).any(|window| window == MESSAGE_MAGIC))
    }

    /// Registers the format described by the FMT message at `start`. An inconsistent format is
    /// ignored.
    fn register_format(&mut self, start: usize) {
        let message = &self.buffer[start..start + FMT_BYTES];
        let (kind, length_bytes) = (message[3], usize::from(message[4]));
        let [name, type_codes, labels] = [&message[5..9], &message[9..25], &message[25..]].map(until_nul);
        let Some(fields) = parse_fields(type_codes, length_bytes) else { return };
        if kind == FMT {
            return;
        }
        let find = |label: &str| {
            let index = labels.split(|byte| *byte == b',').position(|other| other == label.as_bytes());
            index.and_then(|index| fields.get(index)).copied()
        };
        self.formats[usize::from(kind)] = Some(Format { length_bytes, layout: Layout::new(name, &find) });
    }

    /// Reads until `bytes` are buffered or the file ends. Returns the number of buffered bytes.
    fn fill(&mut self, bytes: usize) -> io::Result<usize> {
        if self.end - self.start < bytes {
            self.buffer.copy_within(self.start..self.end, 0);
            (self.start, self.end) = (0, self.end - self.start);
            while self.end < bytes {
                match self.file.read(&mut self.buffer[self.end..])? {
                    0 => break,
                    count => self.end += count,
                }
            }
        }
        Ok(self.end - self.start)
    }

    fn skip(&mut self, bytes: usize) {
        self.start += bytes;
        self.skipped_bytes += bytes as u64;
    }
}

/// Returns the fields of a message type.
///
/// The result is `None` if a type code is unknown or the lengths do not add up to `length_bytes`.
fn parse_fields(type_codes: &[u8], length_bytes: usize) -> Option<Vec<Field>> {
    let mut offset = HEADER_BYTES;
    let mut fields = Vec::new();
    for &type_code in type_codes {
        fields.push(Field { offset, type_code });
        offset += match type_code {
            b'b' | b'B' | b'M' => 1,
            b'g' | b'h' | b'H' | b'c' | b'C' => 2,
            b'i' | b'I' | b'f' | b'n' | b'e' | b'E' | b'L' => 4,
            b'q' | b'Q' | b'd' => 8,
            b'N' => 16,
            b'a' | b'Z' => 64,
            _ => return None,
        };
    }
    (offset == length_bytes).then_some(fields)
}

/// Returns the bytes before the first NUL.
fn until_nul(bytes: &[u8]) -> &[u8] {
    bytes.split(|byte| *byte == 0).next().unwrap_or_default()
}
