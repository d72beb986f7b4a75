//! The messages of a ULog, one by one.
//!
//! The parser is given only what is needed of it: the formats of the wanted topics and their messages, each checked for the length the
//! parser counts on. What it does with the formats of others could cost more than the file is worth, and what it does with some
//! messages that are too short is a panic.

use std::{
    cell::RefCell,
    fs::File,
    io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom},
    path::Path,
};

use px4_ulog::stream_parser::{DataMessage, LogParser};

use crate::{ImportError, error::opening};

const BUFFER_BYTES: usize = 1 << 16;
const HEADER_BYTES: usize = 16;
/// Length of what follows, and type.
const START_BYTES: usize = 3;
/// A message of flags of which none is set.
const NO_FLAGS: [u8; 43] = {
    let mut message = [0; 43];
    (message[0], message[2]) = (40, b'B');
    message
};
/// Between two signs of progress.
const PROGRESS_BYTES: u64 = 1 << 16;

/// How a log ended, and what it says about itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Ending {
    /// Where reading ended before the file did, and what is there.
    pub(crate) damage: Option<(u64, String)>,
    pub(crate) dropouts: u64,
    pub(crate) dropouts_ms: u64,
}

/// Hands every message of the wanted `topics` to `take`, in the order of the file.
pub(crate) fn read(
    path: &Path,
    topics: &[&str],
    progress: &mut dyn FnMut(u64),
    take: &mut dyn FnMut(&DataMessage) -> Result<(), ImportError>,
) -> Result<Ending, ImportError> {
    let failure = RefCell::new(None);
    let mut on_data = |message: &DataMessage| {
        if failure.borrow().is_none()
            && let Err(error) = take(message)
        {
            *failure.borrow_mut() = Some(error);
        }
    };
    let mut parser = LogParser::default();
    parser.set_data_message_callback(&mut on_data);

    let failed = |cause| opening(path, cause);
    let mut messages = Messages::open(path).map_err(failed)?;
    let mut ending = Ending::default();
    let mut wanted = Wanted::default();
    let mut told = 0;
    let damage = loop {
        if messages.position - told >= PROGRESS_BYTES {
            told = messages.position;
            progress(told);
        }
        let at_byte = messages.position;
        let message = match messages.next().map_err(failed)? {
            Next::Message(message) => message,
            Next::End => break None,
            Next::Damage(found) => break Some((at_byte, found)),
        };
        let (kind, content) = (message[START_BYTES - 1], &message[START_BYTES..]);
        let is_fed = at_byte == 0
            || match (kind, content) {
                (b'B', _) => true,
                (b'F', _) => wanted.wants_format(content, topics),
                (b'A', [_, id @ ..]) if id.len() >= 2 => wanted.wants_id(id, topics),
                (b'D', [low, high, ..]) => wanted.ids.contains(&u16::from_le_bytes([*low, *high])),
                (b'O', [low, high, ..]) => {
                    ending.dropouts += 1;
                    ending.dropouts_ms += u64::from(u16::from_le_bytes([*low, *high]));
                    false
                }
                (b'A' | b'D' | b'O', _) => {
                    break Some((at_byte, format!("a message {:?} that is too short", char::from(kind))));
                }
                (b'A'..=b'Z', _) => false,
                (other, _) => break Some((at_byte, format!("a message of the unknown type {other:#04x}"))),
            };
        if at_byte == HEADER_BYTES as u64 && kind != b'B' {
            // Logs of before 2017 have no flags, and the parser waits for them or for a parameter.
            if let Err(error) = parser.consume_bytes(&NO_FLAGS) {
                break Some((at_byte, shortened(&error.description)));
            }
        }
        if is_fed {
            if let Err(error) = parser.consume_bytes(message) {
                break Some((at_byte, shortened(&error.description)));
            }
            if kind == b'B' {
                messages.ends = ends(parser.appended_offsets());
            }
            if let Some(error) = failure.borrow_mut().take() {
                return Err(error);
            }
        }
    };
    progress(messages.position);
    match damage {
        Some((at_byte, found)) if !parser.in_data() => {
            Err(ImportError::NoLog { path: path.to_owned(), at_byte, found })
        }
        damage => Ok(Ending { damage, ..ending }),
    }
}

/// The parser's descriptions may hold whole formats.
fn shortened(description: &str) -> String {
    description.chars().take(100).collect()
}

/// Where what was appended after a crash begins, which cuts what was being written.
fn ends(offsets: &[u64; 3]) -> Vec<u64> {
    offsets.iter().rev().copied().filter(|&offset| offset != 0).collect()
}

/// The numbers of the wanted topics' messages.
#[derive(Default)]
struct Wanted {
    ids: Vec<u16>,
}

impl Wanted {
    fn wants_format(&self, content: &[u8], topics: &[&str]) -> bool {
        let name = content.split(|&byte| byte == b':').next().unwrap_or_default();
        topics.iter().any(|topic| topic.as_bytes() == name)
    }

    fn wants_id(&mut self, id: &[u8], topics: &[&str]) -> bool {
        let [low, high, name @ ..] = id else { return false };
        let is_wanted = topics.iter().any(|topic| topic.as_bytes() == name);
        if is_wanted {
            self.ids.push(u16::from_le_bytes([*low, *high]));
        }
        is_wanted
    }
}

/// The file, cut into messages.
struct Messages {
    file: BufReader<File>,
    message: Vec<u8>,
    position: u64,
    /// Where the sections of the file end, the next one last.
    ends: Vec<u64>,
}

enum Next<'a> {
    Message(&'a [u8]),
    End,
    Damage(String),
}

impl Messages {
    fn open(path: &Path) -> io::Result<Self> {
        let file = BufReader::with_capacity(BUFFER_BYTES, File::open(path)?);
        Ok(Self { file, message: Vec::new(), position: 0, ends: Vec::new() })
    }

    /// The next message with its start; the first one is the header of the file.
    fn next(&mut self) -> io::Result<Next<'_>> {
        let start_bytes = if self.position == 0 { HEADER_BYTES } else { START_BYTES };
        loop {
            let is_new_section = self.ends.last().is_some_and(|&end| self.position + START_BYTES as u64 > end);
            if is_new_section && let Some(end) = self.ends.pop() {
                if end < self.position {
                    return Ok(Next::Damage(format!("a section that begins at byte {end}")));
                }
                self.skip_to(end)?;
                continue;
            }
            self.message.clear();
            match self.fill(start_bytes)? {
                0 => return Ok(Next::End),
                length if length < start_bytes => return Ok(Next::Damage("the end of the file in a message".into())),
                _ => {}
            }
            if self.position == 0 {
                break;
            }
            let length = usize::from(u16::from_le_bytes([self.message[0], self.message[1]])) + START_BYTES;
            if let Some(&end) = self.ends.last().filter(|&&end| self.position + length as u64 > end) {
                // It was being written when the system crashed; what follows was written after that.
                self.ends.pop();
                self.skip_to(end)?;
                continue;
            }
            if self.fill(length)? < length {
                return Ok(Next::Damage("the end of the file in a message".into()));
            }
            break;
        }
        self.position += self.message.len() as u64;
        Ok(Next::Message(&self.message))
    }

    /// Reads on until the message has `length` bytes, or the file ends; gives how many there are.
    fn fill(&mut self, length: usize) -> io::Result<usize> {
        let mut have = self.message.len();
        self.message.resize(length, 0);
        while have < length {
            match self.file.read(&mut self.message[have..]) {
                Ok(0) => break,
                Ok(count) => have += count,
                Err(cause) if cause.kind() == ErrorKind::Interrupted => {}
                Err(cause) => return Err(cause),
            }
        }
        self.message.truncate(have);
        Ok(have)
    }

    fn skip_to(&mut self, position: u64) -> io::Result<()> {
        self.position = position;
        self.file.seek(SeekFrom::Start(position)).map(drop)
    }
}
