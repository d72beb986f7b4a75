//! The messages of a DataFlash log, one by one.
//!
//! Input: a log of ArduPilot, which says in itself how its messages are laid out (FMT). Output: the messages of the wanted types.
//! Memory: a buffer. Failure: of the file alone; bytes that are no message are passed over and counted. There is no checksum: a message
//! counts where another one or the end of the log follows it.
//!
//! Written here because the one parser among the registry's crates ends without a word after 256 faults in a row, does not tell what it
//! passed over, and allocates for each field of each message.

use std::{
    cell::Cell,
    fs::File,
    io::{self, Read},
    path::Path,
    rc::Rc,
};

use super::fields::Layout;
use crate::csv_reader::Counted;

const START: [u8; 2] = [0xa3, 0x95];
/// Start and type.
const START_BYTES: usize = 3;
/// The type of the messages that lay out others.
const FMT: u8 = 0x80;
const FMT_BYTES: usize = 89;
const BUFFER_BYTES: usize = 1 << 16;

/// A field of a message: where it is, and the letter of its type.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    offset: usize,
    letter: u8,
}

/// How a type of message is laid out.
pub(super) struct Format {
    length_bytes: usize,
    /// `None` of a type that nothing is read of.
    layout: Option<Layout>,
}

pub(super) struct Messages {
    file: Counted,
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    formats: [Option<Format>; 256],
    /// Bytes that are no message.
    pub(super) passed_over: u64,
}

impl Messages {
    pub(super) fn open(path: &Path, read_bytes: &Rc<Cell<u64>>) -> io::Result<Self> {
        let mut formats = [const { None }; 256];
        formats[usize::from(FMT)] = Some(Format { length_bytes: FMT_BYTES, layout: None });
        Ok(Self {
            file: Counted::new(File::open(path)?, read_bytes),
            buffer: vec![0; BUFFER_BYTES].into(),
            start: 0,
            end: 0,
            formats,
            passed_over: 0,
        })
    }

    /// The next message of a wanted type, with its layout; `None` at the end.
    pub(super) fn next(&mut self) -> io::Result<Option<(&Layout, &[u8])>> {
        loop {
            let available = self.fill(START_BYTES)?;
            if available < START_BYTES {
                self.pass_over(available);
                return Ok(None);
            }
            let kind = self.buffer[self.start + 2];
            let format = self.formats[usize::from(kind)].as_ref();
            let begins = self.buffer[self.start..].starts_with(&START);
            let Some(length_bytes) = format.filter(|_| begins).map(|format| format.length_bytes) else {
                self.pass_over(1);
                continue;
            };
            let available = self.fill(length_bytes + START.len())?;
            let next = &self.buffer[self.start..self.end][length_bytes.min(available)..];
            let is_followed = next.len() < START.len() || next.starts_with(&START);
            if available < length_bytes || !is_followed {
                self.pass_over(1);
                continue;
            }
            let message = self.start..self.start + length_bytes;
            self.start = message.end;
            if kind == FMT {
                self.learn(message.start);
            } else if self.formats[usize::from(kind)].as_ref().is_some_and(|format| format.layout.is_some()) {
                let layout = self.formats[usize::from(kind)].as_ref().and_then(|format| format.layout.as_ref());
                return Ok(layout.map(|layout| (layout, &self.buffer[message])));
            }
        }
    }

    /// Takes in how a type is laid out; one that contradicts itself is left out.
    fn learn(&mut self, at: usize) {
        let message = &self.buffer[at..at + FMT_BYTES];
        let (kind, length_bytes) = (message[3], usize::from(message[4]));
        let [name, letters, labels] = [&message[5..9], &message[9..25], &message[25..]].map(text);
        let Some(fields) = fields(letters, length_bytes) else { return };
        if kind == FMT {
            return;
        }
        let find = |label: &str| {
            let index = labels.split(|byte| *byte == b',').position(|other| other == label.as_bytes());
            index.and_then(|index| fields.get(index)).copied()
        };
        self.formats[usize::from(kind)] = Some(Format { length_bytes, layout: Layout::of(name, &find) });
    }

    /// Reads until so many bytes are there, or the end; tells how many are.
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

    fn pass_over(&mut self, bytes: usize) {
        self.start += bytes;
        self.passed_over += bytes as u64;
    }
}

/// The fields of a message of so many bytes; `None` where they do not fill it, or a letter is unknown.
fn fields(letters: &[u8], length_bytes: usize) -> Option<Vec<Field>> {
    let mut offset = START_BYTES;
    let mut fields = Vec::new();
    for &letter in letters {
        fields.push(Field { offset, letter });
        offset += match letter {
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

/// The bytes before the first zero.
fn text(bytes: &[u8]) -> &[u8] {
    bytes.split(|byte| *byte == 0).next().unwrap_or_default()
}

impl Field {
    /// What a message says in this field; nan where that is no number.
    pub(super) fn number(self, message: &[u8]) -> f64 {
        let Some(bytes) = message.get(self.offset..) else { return f64::NAN };
        macro_rules! number {
            ($type:ty) => {
                bytes.first_chunk().map_or(f64::NAN, |bytes| <$type>::from_le_bytes(*bytes) as f64)
            };
        }
        match self.letter {
            b'b' => number!(i8),
            b'B' | b'M' => number!(u8),
            b'h' => number!(i16),
            b'H' => number!(u16),
            b'i' => number!(i32),
            b'I' => number!(u32),
            b'q' => number!(i64),
            b'Q' => number!(u64),
            b'f' => number!(f32),
            b'd' => number!(f64),
            b'c' => number!(i16) / 100.0,
            b'C' => number!(u16) / 100.0,
            b'e' => number!(i32) / 100.0,
            b'E' => number!(u32) / 100.0,
            b'L' => number!(i32) / 1e7,
            _ => f64::NAN,
        }
    }

    /// What a message says in this field, where that is a whole number that is not negative.
    pub(super) fn whole(self, message: &[u8]) -> Option<u64> {
        let bytes = message.get(self.offset..)?;
        match self.letter {
            b'B' => bytes.first().map(|byte| (*byte).into()),
            b'H' => bytes.first_chunk().map(|bytes| u16::from_le_bytes(*bytes).into()),
            b'I' => bytes.first_chunk().map(|bytes| u32::from_le_bytes(*bytes).into()),
            b'Q' => bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes)),
            _ => None,
        }
    }
}
