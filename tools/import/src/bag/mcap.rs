//! The messages of an MCAP file, in its order.
//!
//! Each chunk is read by itself, so that one that is damaged is left out and the next is read. Memory: a record or a chunk, each up to
//! [`MAX_RECORD_BYTES`].

use std::{
    cell::Cell,
    collections::{HashMap, HashSet},
    fs::File,
    io::{self, BufReader, Read},
    path::Path,
    rc::Rc,
};

use mcap::{
    McapError,
    records::{Record, op},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use super::{Message, Stop, topics::Topic};
use crate::{error::opening, csv_reader::Counted};

/// The largest record or chunk that is read.
const MAX_RECORD_BYTES: usize = 1 << 27;
/// The largest message of a topic that is read.
const MAX_MESSAGE_BYTES: usize = 1 << 16;
const BUFFER_BYTES: usize = 1 << 16;
const MAGIC_BYTES: u64 = 8;
/// Type and length of a record.
const RECORD_START_BYTES: usize = 9;

pub(super) struct Cursor {
    file: BufReader<Counted>,
    reader: LinearReader,
    chunk: Option<Chunk>,
    directory: Directory,
    position: u64,
    /// Chunks that were left out.
    pub(super) damaged_chunks: u64,
}

/// A chunk in memory, with the start of its record.
struct Chunk {
    reader: LinearReader,
    bytes: io::Cursor<Vec<u8>>,
}

/// The channels seen so far, and what the last record was.
struct Directory {
    wanted: Option<HashSet<Topic>>,
    schemas: HashMap<u16, String>,
    topics: HashMap<u16, Rc<Topic>>,
    message: Option<Message>,
    chunk: Option<Vec<u8>>,
    has_ended: bool,
}

enum Pulled {
    Record { length_bytes: usize },
    End,
}

impl Cursor {
    /// Opens a file for the messages of the `wanted` topics, or of all that can be read.
    pub(super) fn open(
        path: &Path,
        wanted: Option<&[Topic]>,
        read_bytes: &Rc<Cell<u64>>,
    ) -> Result<Self, crate::ImportError> {
        let file = File::open(path).map_err(|cause| opening(path, cause))?;
        let file = BufReader::with_capacity(BUFFER_BYTES, Counted::new(file, read_bytes));
        let options = LinearReaderOptions::default().with_emit_chunks(true);
        let directory = Directory {
            wanted: wanted.map(|wanted| wanted.iter().cloned().collect()),
            schemas: HashMap::new(),
            topics: HashMap::new(),
            message: None,
            chunk: None,
            has_ended: false,
        };
        Ok(Self {
            file,
            reader: LinearReader::new_with_options(options.with_record_length_limit(MAX_RECORD_BYTES)),
            chunk: None,
            directory,
            position: MAGIC_BYTES,
            damaged_chunks: 0,
        })
    }

    /// The next message; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Message>, Stop> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match pull(&mut chunk.reader, &mut chunk.bytes, |kind, data| self.directory.take(kind, data)) {
                    Ok(Pulled::Record { .. }) => {}
                    Ok(Pulled::End) => self.chunk = None,
                    Err(_) => {
                        self.damaged_chunks += 1;
                        self.chunk = None;
                    }
                }
            } else {
                let pulled = pull(&mut self.reader, &mut self.file, |kind, data| self.directory.take(kind, data));
                let at = |found: &dyn std::fmt::Display| Stop::Damage(format!("byte {}: {found}", self.position));
                match pulled {
                    Ok(Pulled::Record { length_bytes }) => {
                        self.position += (RECORD_START_BYTES + length_bytes) as u64;
                    }
                    Ok(Pulled::End) | Err(McapError::UnexpectedEof) => return Err(at(&"the file was cut here")),
                    Err(cause) => return Err(at(&cause)),
                }
                if let Some(bytes) = self.directory.chunk.take() {
                    self.chunk = Chunk::of(bytes);
                    self.damaged_chunks += u64::from(self.chunk.is_none());
                }
                if self.directory.has_ended {
                    return Ok(None);
                }
            }
            if let Some(message) = self.directory.message.take() {
                return Ok(Some(message));
            }
        }
    }
}

impl Chunk {
    /// `None` of a chunk that is none.
    fn of(bytes: Vec<u8>) -> Option<Self> {
        let record = mcap::parse_record(op::CHUNK, &bytes[RECORD_START_BYTES..]).ok()?;
        let Record::Chunk { header, data } = record else { return None };
        // The reader counts on it.
        if header.compression.is_empty() && !is_whole_records(&data) {
            return None;
        }
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        Some(Self { reader: LinearReader::new_with_options(options), bytes: io::Cursor::new(bytes) })
    }
}

/// Records that end where the bytes end.
fn is_whole_records(mut bytes: &[u8]) -> bool {
    while !bytes.is_empty() {
        let Some((start, rest)) = bytes.split_at_checked(RECORD_START_BYTES) else { return false };
        let length = start[1..].try_into().map_or(u64::MAX, u64::from_le_bytes);
        let Some(rest) = usize::try_from(length).ok().and_then(|length| rest.get(length..)) else { return false };
        bytes = rest;
    }
    true
}

impl Directory {
    fn take(&mut self, kind: u8, data: &[u8]) {
        match kind {
            op::DATA_END => self.has_ended = true,
            op::CHUNK => {
                let length = (data.len() as u64).to_le_bytes();
                self.chunk = Some([&[op::CHUNK][..], &length, data].concat());
            }
            op::MESSAGE => {
                let topic = data.first_chunk().and_then(|id| self.topics.get(&u16::from_le_bytes(*id)));
                if let Some(topic) = topic
                    && data.len() <= MAX_MESSAGE_BYTES
                    && let Ok(Record::Message { data, .. }) = mcap::parse_record(kind, data)
                {
                    self.message = Some(Message { topic: topic.clone(), data: data.into_owned() });
                }
            }
            // What is malformed has no messages that are read.
            op::SCHEMA => {
                if let Ok(Record::Schema { header, .. }) = mcap::parse_record(kind, data)
                    && header.name.len() <= MAX_MESSAGE_BYTES
                {
                    self.schemas.insert(header.id, header.name);
                }
            }
            op::CHANNEL => {
                if let Ok(Record::Channel(channel)) = mcap::parse_record(kind, data) {
                    let schema = self.schemas.get(&channel.schema_id).map_or("", String::as_str);
                    let topic = Topic::of(&channel.topic, &channel.message_encoding, schema);
                    let is_wanted = |topic: &Topic| self.wanted.as_ref().is_none_or(|wanted| wanted.contains(topic));
                    match topic.filter(is_wanted) {
                        Some(topic) => self.topics.insert(channel.id, Rc::new(topic)),
                        None => self.topics.remove(&channel.id),
                    };
                }
            }
            _ => {}
        }
    }
}

/// Hands the next record to `take`.
fn pull(
    reader: &mut LinearReader,
    source: &mut impl Read,
    mut take: impl FnMut(u8, &[u8]),
) -> Result<Pulled, McapError> {
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(bytes) => {
                let count = source.read(reader.insert(bytes))?;
                reader.notify_read(count);
            }
            LinearReadEvent::Record { opcode, data } => {
                take(opcode, data);
                return Ok(Pulled::Record { length_bytes: data.len() });
            }
        }
    }
    Ok(Pulled::End)
}
