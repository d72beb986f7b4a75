//! Reader of the messages in an MCAP file, in file order.
//!
//! Each chunk is read separately, so that a damaged chunk is skipped and the next one is read.
//!
//! Memory: one record or chunk, up to [`MAX_RECORD_BYTES`].

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

use super::{
    message::{Message, ReadError},
    topics::Topic,
};
use crate::{csv_reader::CountingReader, error::open_error};

/// Maximum length of a record or chunk, bytes. Reading stops at the first record or chunk that is
/// longer.
const MAX_RECORD_BYTES: usize = 1 << 27;
/// Maximum length of a message record, bytes. Longer messages are ignored.
const MAX_MESSAGE_BYTES: usize = 1 << 16;
const BUFFER_BYTES: usize = 1 << 16;
const MAGIC_BYTES: u64 = 8;
/// Maximum ratio of the declared uncompressed size of a chunk to its compressed size. Chunks from
/// real recorders stay far below it.
const MAX_CHUNK_RATIO: u64 = 1000;
/// Length of the type and length fields at the start of a record, bytes.
const RECORD_HEADER_BYTES: usize = 9;

/// Cursor over the messages in an MCAP file.
pub(super) struct Cursor {
    file: BufReader<CountingReader>,
    reader: LinearReader,
    chunk: Option<Chunk>,
    records: RecordHandler,
    position: u64,
    /// Number of chunks skipped because they are damaged.
    pub(super) damaged_chunks: u64,
}

/// Chunk in memory, as a complete record with its header.
struct Chunk {
    reader: LinearReader,
    bytes: io::Cursor<Vec<u8>>,
}

/// Record handler with the channels seen so far and the content of the last record.
struct RecordHandler {
    wanted: Option<HashSet<Topic>>,
    schemas: HashMap<u16, String>,
    topics: HashMap<u16, Rc<Topic>>,
    message: Option<Message>,
    chunk: Option<Vec<u8>>,
    has_ended: bool,
}

enum ReadOutcome {
    Record { length_bytes: usize },
    End,
}

impl Cursor {
    /// Opens a file to read the messages of the `wanted` topics, or of all readable topics if
    /// `None`.
    pub(super) fn open(
        path: &Path,
        wanted: Option<&[Topic]>,
        read_bytes: &Rc<Cell<u64>>,
    ) -> Result<Self, crate::ImportError> {
        let file = File::open(path).map_err(|cause| open_error(path, cause))?;
        let file = BufReader::with_capacity(BUFFER_BYTES, CountingReader::new(file, read_bytes));
        let options = LinearReaderOptions::default().with_emit_chunks(true);
        let records = RecordHandler {
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
            records,
            position: MAGIC_BYTES,
            damaged_chunks: 0,
        })
    }

    /// Returns the next message, or `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<Message>, ReadError> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match read_record(&mut chunk.reader, &mut chunk.bytes, |kind, data| self.records.handle(kind, data)) {
                    Ok(ReadOutcome::Record { .. }) => {}
                    Ok(ReadOutcome::End) => self.chunk = None,
                    Err(_) => {
                        self.damaged_chunks += 1;
                        self.chunk = None;
                    }
                }
            } else {
                let read = read_record(&mut self.reader, &mut self.file, |kind, data| self.records.handle(kind, data));
                let damage = |found: &dyn std::fmt::Display| {
                    ReadError::Damage(format!("byte {}: {found}", self.position).into())
                };
                match read {
                    Ok(ReadOutcome::Record { length_bytes }) => {
                        self.position += (RECORD_HEADER_BYTES + length_bytes) as u64;
                    }
                    Ok(ReadOutcome::End) | Err(McapError::UnexpectedEof) => {
                        return Err(damage(&"unexpected end of the file"));
                    }
                    Err(cause) => return Err(damage(&cause)),
                }
                if let Some(bytes) = self.records.chunk.take() {
                    self.chunk = Chunk::parse(bytes);
                    self.damaged_chunks += u64::from(self.chunk.is_none());
                }
                if self.records.has_ended {
                    return Ok(None);
                }
            }
            if let Some(message) = self.records.message.take() {
                return Ok(Some(message));
            }
        }
    }
}

impl Chunk {
    /// Parses a chunk record; `None` if it is damaged.
    fn parse(bytes: Vec<u8>) -> Option<Self> {
        let record = mcap::parse_record(op::CHUNK, &bytes[RECORD_HEADER_BYTES..]).ok()?;
        let Record::Chunk { header, data } = record else { return None };
        let max_bytes = header.compressed_size.saturating_mul(MAX_CHUNK_RATIO).min(MAX_RECORD_BYTES as u64);
        if header.uncompressed_size > max_bytes {
            return None;
        }
        // The MCAP reader assumes that an uncompressed chunk consists of complete records.
        if header.compression.is_empty() && !contains_complete_records(&data) {
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

/// Returns `true` if the bytes consist of complete records.
fn contains_complete_records(mut bytes: &[u8]) -> bool {
    while !bytes.is_empty() {
        let Some((start, rest)) = bytes.split_at_checked(RECORD_HEADER_BYTES) else { return false };
        let length = start[1..].try_into().map_or(u64::MAX, u64::from_le_bytes);
        let Some(rest) = usize::try_from(length).ok().and_then(|length| rest.get(length..)) else { return false };
        bytes = rest;
    }
    true
}

impl RecordHandler {
    fn handle(&mut self, kind: u8, data: &[u8]) {
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
                    && let Ok(Record::Message { header, data }) = mcap::parse_record(kind, data)
                {
                    let log_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                    self.message = Some(Message { topic: topic.clone(), log_ns, data: data.into_owned() });
                }
            }
            // Malformed schemas and channels are ignored, and so are their messages.
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
                    let topic = Topic::from_channel(&channel.topic, &channel.message_encoding, schema);
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

/// Reads the next record and passes it to `handle`.
fn read_record(
    reader: &mut LinearReader,
    source: &mut impl Read,
    mut handle: impl FnMut(u8, &[u8]),
) -> Result<ReadOutcome, McapError> {
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(bytes) => {
                let count = source.read(reader.insert(bytes))?;
                reader.notify_read(count);
            }
            LinearReadEvent::Record { opcode, data } => {
                handle(opcode, data);
                return Ok(ReadOutcome::Record { length_bytes: data.len() });
            }
        }
    }
    Ok(ReadOutcome::End)
}
