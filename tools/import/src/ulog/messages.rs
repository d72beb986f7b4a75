//! Reads the messages of a ULog.
//!
//! The ULog parser receives only the formats and messages of the wanted topics, and only after
//! their lengths have been checked. Otherwise, the parser could take very long for deeply nested
//! formats of other topics, and could panic on messages that are too short.

use std::{
    cell::RefCell,
    collections::HashSet,
    fs::File,
    io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom},
    path::Path,
};

use foreign::ForeignText;
use px4_ulog::stream_parser::{DataMessage, LogParser};

use crate::{ImportError, error::open_error};

const BUFFER_BYTES: usize = 1 << 16;
const HEADER_BYTES: usize = 16;
/// Length of the size and type fields at the start of a message, bytes.
const MESSAGE_HEADER_BYTES: usize = 3;
/// ULog message of type `B` (flag bits) in which no flag is set.
const EMPTY_FLAGS_MESSAGE: [u8; 43] = {
    let mut message = [0; 43];
    (message[0], message[2]) = (40, b'B');
    message
};
/// Maximum number of damaged parts that are skipped. This limits the time that a hostile log can
/// take.
const MAX_RESYNCS: u32 = 10_000;
/// Number of consecutive messages that are checked after a damaged part.
const CHECKED_MESSAGES: usize = 4;
/// Maximum length in bytes of a message that is checked.
const MAX_CHECKED_BYTES: usize = 1 << 12;
/// Number of bytes that contain the checked messages.
const CHECKED_BYTES: usize = CHECKED_MESSAGES * MAX_CHECKED_BYTES;
/// Number of bytes that are searched at a time.
const SEARCH_WINDOW_BYTES: usize = 1 << 16;
/// Content of a synchronisation message.
const SYNC: [u8; 8] = [0x2f, 0x73, 0x13, 0x20, 0x25, 0x0c, 0xbb, 0x12];
/// Number of bytes between two progress reports.
const PROGRESS_INTERVAL_BYTES: u64 = 1 << 16;

/// State of a log after it has been read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct LogStatus {
    /// Offset and description of the damage that ended reading; `None` if the log is complete.
    pub(crate) damage: Option<(u64, ForeignText)>,
    pub(crate) dropouts: u64,
    pub(crate) dropouts_ms: u64,
    /// Number of messages with an unknown type, without a subscribed topic or with invalid content.
    pub(crate) malformed: u64,
    /// Number of bytes in the damaged parts that were skipped.
    pub(crate) skipped_bytes: u64,
}

/// Passes all messages of the wanted `topics` to `on_message`, in file order.
pub(crate) fn read(
    path: &Path,
    topics: &[&str],
    progress: &mut dyn FnMut(u64),
    on_message: &mut dyn FnMut(&DataMessage) -> Result<(), ImportError>,
) -> Result<LogStatus, ImportError> {
    let failure = RefCell::new(None);
    let mut on_data = |message: &DataMessage| {
        if failure.borrow().is_none()
            && let Err(error) = on_message(message)
        {
            *failure.borrow_mut() = Some(error);
        }
    };
    let mut parser = LogParser::default();
    parser.set_data_message_callback(&mut on_data);

    let failed = |cause| open_error(path, cause);
    let mut messages = MessageReader::open(path).map_err(failed)?;
    let mut status = LogStatus::default();
    let mut filter = TopicFilter::default();
    let mut reported = 0;
    let mut resyncs = 0;
    let damage = loop {
        if messages.position - reported >= PROGRESS_INTERVAL_BYTES {
            reported = messages.position;
            progress(reported);
        }
        let at_byte = messages.position;
        let next = read_next(&mut messages, &mut parser, &mut filter, topics, &mut status).map_err(failed)?;
        let found = match next {
            Next::Read => {
                if let Some(error) = failure.borrow_mut().take() {
                    return Err(error);
                }
                continue;
            }
            Next::End => break None,
            Next::Damage(found) => found,
        };
        let can_resync = parser.in_data() && resyncs < MAX_RESYNCS;
        resyncs += 1;
        if !can_resync || !messages.resync(at_byte + 1, &filter.subscribed).map_err(failed)? {
            break Some((at_byte, found));
        }
        status.skipped_bytes += messages.position - at_byte;
    };
    progress(messages.position);
    match damage {
        Some((at_byte, found)) if !parser.in_data() => {
            Err(ImportError::DamagedStart { path: path.to_owned(), at_byte, found })
        }
        damage => Ok(LogStatus { damage, ..status }),
    }
}

/// Outcome of reading a message.
enum Next {
    /// The message was read.
    Read,
    End,
    Damage(ForeignText),
}

/// Reads the next message and passes it to the parser if it is wanted.
fn read_next(
    messages: &mut MessageReader,
    parser: &mut LogParser<'_>,
    filter: &mut TopicFilter,
    topics: &[&str],
    status: &mut LogStatus,
) -> io::Result<Next> {
    let at_byte = messages.position;
    let damage = |found: String| Ok(Next::Damage(found.into()));
    let message = match messages.next()? {
        NextMessage::Message(message) => message,
        NextMessage::End => return Ok(Next::End),
        NextMessage::Damage(found) => return Ok(Next::Damage(found)),
    };
    let (kind, content) = (message[MESSAGE_HEADER_BYTES - 1], &message[MESSAGE_HEADER_BYTES..]);
    let mut is_malformed = false;
    let is_for_parser = at_byte == 0
        || match (kind, content) {
            (b'B', _) => true,
            (b'F', _) => {
                is_malformed = parser.in_data();
                filter.accepts_format(content, topics)
            }
            (b'A', [_, id @ ..]) if id.len() >= 2 => filter.accept_subscription(id, topics),
            (b'D', [low, high, ..]) => {
                let id = u16::from_le_bytes([*low, *high]);
                is_malformed = !filter.subscribed.contains(&id);
                filter.ids.contains(&id)
            }
            (b'O', [low, high, ..]) => {
                status.dropouts += 1;
                status.dropouts_ms += u64::from(u16::from_le_bytes([*low, *high]));
                false
            }
            (b'A' | b'D' | b'O', _) => return damage(format!("a message {:?} that is too short", char::from(kind))),
            (b'A'..=b'Z', _) => {
                is_malformed = !is_valid(kind, content);
                false
            }
            (other, _) => return damage(format!("a message of unknown type {other:#04x}")),
        };
    if at_byte == HEADER_BYTES as u64 && kind != b'B' {
        // Logs from before 2017 have no flags message, but the parser requires the first message to
        // be a flags message or a parameter.
        if let Err(error) = parser.consume_bytes(&EMPTY_FLAGS_MESSAGE) {
            return Ok(Next::Damage(shorten(&error.description)));
        }
    }
    if is_for_parser {
        if let Err(error) = parser.consume_bytes(message) {
            return Ok(Next::Damage(shorten(&error.description)));
        }
        if kind == b'B' {
            messages.section_ends = section_ends(parser.appended_offsets());
        }
    }
    if is_malformed {
        // The length of a damaged message may be wrong. Reading continues here only if another
        // message starts at the current position.
        if parser.in_data() && !messages.is_at_message(&filter.subscribed)? {
            return damage(format!("a malformed message {:?}", char::from(kind)));
        }
        status.malformed += 1;
    }
    Ok(Next::Read)
}

/// Shortens an error description from the parser, which may contain whole formats.
fn shorten(description: &str) -> ForeignText {
    description.chars().take(100).collect::<String>().into()
}

/// Returns the offsets of the sections that were appended after a crash, in descending order.
///
/// Each offset is also the end of the previous section.
fn section_ends(offsets: &[u64; 3]) -> Vec<u64> {
    offsets.iter().rev().copied().filter(|&offset| offset != 0).collect()
}

/// Returns `true` if the content of a message that is not decoded fits its type. Damage often
/// changes the type of a message, so the content then no longer fits.
fn is_valid(kind: u8, content: &[u8]) -> bool {
    let has_key = |key_at: usize| {
        let key_bytes = content.get(key_at).copied().map_or(usize::MAX, usize::from);
        key_bytes < content.len() - key_at
    };
    match kind {
        b'I' | b'P' => !content.is_empty() && has_key(0),
        b'M' | b'Q' => content.len() > 1 && has_key(1),
        b'L' | b'C' => matches!(content.first(), Some(b'0'..=b'7')),
        b'S' => content == SYNC,
        b'R' => content.len() >= size_of::<u16>(),
        _ => false,
    }
}

/// Returns `true` if a message of the data section starts here. `is_end` is `true` if the file ends
/// after `rest`.
///
/// Messages have no checksum. Random bytes can look like a single message, so the following
/// messages are checked as well.
fn is_message_start(rest: &[u8], is_end: bool, subscribed: &HashSet<u16>) -> bool {
    let (mut offset, mut has_data) = (0, false);
    for number in 0..CHECKED_MESSAGES {
        let header = rest.get(offset..).and_then(|rest| rest.first_chunk::<MESSAGE_HEADER_BYTES>());
        let Some(&[low, high, kind]) = header else {
            return has_data && is_end && (offset == rest.len() || number >= CHECKED_MESSAGES / 2);
        };
        let length = usize::from(u16::from_le_bytes([low, high])) + MESSAGE_HEADER_BYTES;
        let Some(content) = rest.get(offset + MESSAGE_HEADER_BYTES..offset + length) else {
            return has_data && is_end && number >= CHECKED_MESSAGES / 2;
        };
        let is_plausible = match (kind, content) {
            (b'D', [low, high, _, ..]) => subscribed.contains(&u16::from_le_bytes([*low, *high])),
            (b'A', [_, _, _, name @ ..]) => !name.is_empty() && name.is_ascii(),
            (b'O', content) => content.len() == size_of::<u16>(),
            (b'I' | b'P' | b'M' | b'Q' | b'S' | b'L', content) => is_valid(kind, content),
            _ => false,
        };
        if !is_plausible || length > MAX_CHECKED_BYTES {
            return false;
        }
        has_data |= kind == b'D';
        offset += length;
    }
    has_data
}

/// Filter of messages by topic.
#[derive(Default)]
struct TopicFilter {
    /// Identifiers of the wanted topics.
    ids: Vec<u16>,
    /// Identifiers of all topics.
    subscribed: HashSet<u16>,
}

impl TopicFilter {
    fn accepts_format(&self, content: &[u8], topics: &[&str]) -> bool {
        let name = content.split(|&byte| byte == b':').next().unwrap_or_default();
        topics.iter().any(|topic| topic.as_bytes() == name)
    }

    fn accept_subscription(&mut self, id: &[u8], topics: &[&str]) -> bool {
        let [low, high, name @ ..] = id else { return false };
        let id = u16::from_le_bytes([*low, *high]);
        self.subscribed.insert(id);
        let is_wanted = topics.iter().any(|topic| topic.as_bytes() == name);
        if is_wanted {
            self.ids.push(id);
        }
        is_wanted
    }
}

/// Reader that splits the file into messages.
struct MessageReader {
    file: BufReader<File>,
    message: Vec<u8>,
    position: u64,
    /// Ends of the sections of the file, in descending order.
    section_ends: Vec<u64>,
}

enum NextMessage<'a> {
    Message(&'a [u8]),
    End,
    Damage(ForeignText),
}

impl MessageReader {
    fn open(path: &Path) -> io::Result<Self> {
        let file = BufReader::with_capacity(BUFFER_BYTES, File::open(path)?);
        Ok(Self { file, message: Vec::new(), position: 0, section_ends: Vec::new() })
    }

    /// Returns the next message with its header. The first message is the file header.
    fn next(&mut self) -> io::Result<NextMessage<'_>> {
        let header_bytes = if self.position == 0 { HEADER_BYTES } else { MESSAGE_HEADER_BYTES };
        loop {
            let is_new_section =
                self.section_ends.last().is_some_and(|&end| self.position + MESSAGE_HEADER_BYTES as u64 > end);
            if is_new_section && let Some(end) = self.section_ends.pop() {
                if end < self.position {
                    return Ok(NextMessage::Damage(format!("an overlapping section that starts at byte {end}").into()));
                }
                self.skip_to(end)?;
                continue;
            }
            self.message.clear();
            match self.fill(header_bytes)? {
                0 => return Ok(NextMessage::End),
                length if length < header_bytes => {
                    return Ok(NextMessage::Damage("the end of the file within a message".into()));
                }
                _ => {}
            }
            if self.position == 0 {
                break;
            }
            let length = usize::from(u16::from_le_bytes([self.message[0], self.message[1]])) + MESSAGE_HEADER_BYTES;
            if let Some(&end) = self.section_ends.last().filter(|&&end| self.position + length as u64 > end) {
                // The message was interrupted by a crash. The next section was appended later.
                self.section_ends.pop();
                self.skip_to(end)?;
                continue;
            }
            if self.fill(length)? < length {
                return Ok(NextMessage::Damage("the end of the file within a message".into()));
            }
            break;
        }
        self.position += self.message.len() as u64;
        Ok(NextMessage::Message(&self.message))
    }

    /// Returns `true` if a message or the end of the file is at the current position.
    fn is_at_message(&mut self, subscribed: &HashSet<u16>) -> io::Result<bool> {
        let mut rest = Vec::new();
        self.file.by_ref().take(CHECKED_BYTES as u64).read_to_end(&mut rest)?;
        self.skip_to(self.position)?;
        Ok(rest.is_empty() || is_message_start(&rest, rest.len() < CHECKED_BYTES, subscribed))
    }

    /// Moves to the first message at or after `from`. Returns `false` at the end of the
    /// file.
    fn resync(&mut self, from: u64, subscribed: &HashSet<u16>) -> io::Result<bool> {
        self.file.seek(SeekFrom::Start(from))?;
        let (mut window, mut start) = (Vec::new(), from);
        loop {
            let missing = SEARCH_WINDOW_BYTES - window.len();
            self.file.by_ref().take(missing as u64).read_to_end(&mut window)?;
            let is_end = window.len() < SEARCH_WINDOW_BYTES;
            let searched = if is_end { window.len() } else { window.len() - CHECKED_BYTES };
            let found = (0..searched).find(|at| is_message_start(&window[*at..], is_end, subscribed));
            if let Some(at) = found {
                let position = start + at as u64;
                self.section_ends.retain(|end| *end > position);
                self.skip_to(position)?;
                return Ok(true);
            }
            if is_end {
                return Ok(false);
            }
            window.drain(..searched);
            start += searched as u64;
        }
    }

    /// Reads until the message has `length` bytes or the file ends.
    ///
    /// Returns the number of bytes in the message.
    fn fill(&mut self, length: usize) -> io::Result<usize> {
        let mut available = self.message.len();
        self.message.resize(length, 0);
        while available < length {
            match self.file.read(&mut self.message[available..]) {
                Ok(0) => break,
                Ok(count) => available += count,
                Err(cause) if cause.kind() == ErrorKind::Interrupted => {}
                Err(cause) => return Err(cause),
            }
        }
        self.message.truncate(available);
        Ok(available)
    }

    fn skip_to(&mut self, position: u64) -> io::Result<()> {
        self.position = position;
        self.file.seek(SeekFrom::Start(position)).map(drop)
    }
}
