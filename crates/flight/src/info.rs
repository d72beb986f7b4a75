//! Content of a flight, from its summary or, if the summary is missing, from its records.
//!
//! Input: an MCAP file.
//!
//! Output: [`FlightInfo`].
//!
//! Failure: files that cannot be opened or are not MCAP are rejected. A truncated or damaged file
//! is reported as incomplete, with the content of its readable part.

use std::{
    collections::BTreeMap,
    fmt,
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use foreign::ForeignText;
use launch::pluralize;
use mcap::{
    McapError, McapResult, parse_record,
    records::{AttachmentHeader, MetadataIndex, Record},
    sans_io::{
        linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
        summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
    },
};
use serde::Serialize;

use crate::{
    FlightError,
    writer::{END_METADATA, HEADER_METADATA, MISSED_METADATA},
};

/// Maximum length of a record, bytes. A longer record is treated as damage.
pub(crate) const MAX_RECORD_BYTES: usize = 64 << 20;
/// Maximum ratio of the size of the records to that of the file. Recorded flights stay below 10. A
/// file crafted to keep the reader busy can exceed 5000.
const MAX_RATIO: u64 = 250;
/// Size of the records below which the ratio is not limited, bytes.
const MIN_LIMITED_BYTES: u64 = 1 << 26;
/// Length of the opcode and the length field at the start of each record, bytes.
const RECORD_HEADER_BYTES: usize = 9;

/// Entries of a metadata record: values by name.
pub type Entries = BTreeMap<ForeignText, ForeignText>;

/// Content of a flight.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FlightInfo {
    /// Path of the file.
    pub file: PathBuf,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Reason why the file is incomplete, for example because the recorder was killed; `None` if it
    /// is complete.
    pub incomplete: Option<ForeignText>,
    /// Time from the first message to the last, s.
    pub seconds: f64,
    /// Number of messages, including those for viewers.
    pub messages: u64,
    /// Channels, sorted by topic.
    pub topics: Vec<ChannelInfo>,
    /// Lower bound on the number of published messages that are missing from the file, by channel.
    pub missed: BTreeMap<ForeignText, u64>,
    /// Reason why the recording ended, if known.
    pub end_reason: Option<ForeignText>,
    /// Other metadata records by name. They contain the system, version, host and start time.
    pub metadata: BTreeMap<ForeignText, Entries>,
    /// Attached files.
    pub attachments: Vec<AttachmentInfo>,
}

/// Channel of a flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Topic of the channel, with a leading slash.
    pub topic: ForeignText,
    /// Name of the schema; empty if there is no schema.
    pub schema: ForeignText,
    /// Encoding of the messages.
    pub encoding: ForeignText,
    /// Number of messages.
    pub messages: u64,
    /// Mean message rate over the flight, if known.
    pub rate_hz: Option<f64>,
}

/// Attachment of a flight.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AttachmentInfo {
    /// Name of the attachment.
    pub name: ForeignText,
    /// Media type.
    pub media_type: ForeignText,
    /// Length of the data, bytes.
    pub bytes: u64,
}

impl FlightInfo {
    /// Reads the content of the file at `path`.
    ///
    /// # Errors
    ///
    /// Returns [`FlightError::Read`] if the file cannot be read and [`FlightError::Malformed`] if
    /// it is not MCAP. A truncated or damaged file is not an error.
    pub fn read(path: &Path) -> Result<Self, FlightError> {
        let read_error = |cause| FlightError::Read { path: path.to_owned(), cause };
        let mut file = File::open(path).map_err(read_error)?;
        let bytes = file.metadata().map_err(read_error)?.len();
        let mut info = match from_summary(&mut file, bytes) {
            Ok(Some(info)) => info,
            without_summary => {
                file.rewind().map_err(read_error)?;
                let mut info = Self { incomplete: Some("no summary".into()), ..Self::default() };
                match (scan_records(&mut file, &mut info), without_summary) {
                    (Err(McapError::BadMagic), _) => {
                        return Err(FlightError::Malformed {
                            path: path.to_owned(),
                            cause: McapError::BadMagic.to_string().into(),
                        });
                    }
                    // Only a read error has an OS error code. A decompression error has none.
                    (Err(McapError::Io(cause)), _) if cause.raw_os_error().is_some() => return Err(read_error(cause)),
                    (Err(McapError::UnexpectedEof), _) => info.incomplete = Some("the file ends early".into()),
                    (Err(damage), _) => {
                        info.incomplete = Some(format!("the file is damaged: {}", reason(&damage)).into())
                    }
                    (Ok(()), Err(damage)) => {
                        info.incomplete = Some(format!("the summary is damaged: {}", reason(&damage)).into())
                    }
                    (Ok(()), Ok(_)) => {}
                }
                info
            }
        };
        (info.file, info.bytes) = (path.to_owned(), bytes);
        info.derive_totals();
        Ok(info)
    }

    /// Derives totals and rates from the channels, and `missed` and `end_reason` from the metadata.
    fn derive_totals(&mut self) {
        let entries = self.metadata.remove(MISSED_METADATA).unwrap_or_default();
        self.missed =
            entries.into_iter().filter_map(|(topic, count)| Some((topic, count.raw().parse().ok()?))).collect();
        self.end_reason = self.metadata.remove(END_METADATA).and_then(|mut end| end.remove("reason"));
        self.messages = self.topics.iter().map(|topic| topic.messages).sum();
        self.topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        for topic in &mut self.topics {
            let intervals = topic.messages.saturating_sub(1) as f64;
            topic.rate_hz = Some(intervals / self.seconds).filter(|rate_hz| rate_hz.is_finite());
        }
    }

    fn header_entry(&self, name: &str) -> ForeignText {
        let entry = self.metadata.get(HEADER_METADATA).and_then(|entries| entries.get(name));
        entry.cloned().unwrap_or_else(|| "unknown".into())
    }
}

/// Reads the summary at the end of the file; `None` if the file has no summary.
fn from_summary(file: &mut File, bytes: u64) -> McapResult<Option<FlightInfo>> {
    let options = SummaryReaderOptions::default().with_file_size(bytes).with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    let Some(summary) = reader.finish() else { return Ok(None) };
    let Some(counts) = summary.stats else { return Ok(None) };
    let mut info = FlightInfo {
        seconds: counts.message_end_time.saturating_sub(counts.message_start_time) as f64 * 1e-9,
        ..FlightInfo::default()
    };
    for channel in summary.channels.values() {
        info.topics.push(ChannelInfo {
            topic: channel.topic.as_str().into(),
            schema: channel.schema.as_ref().map(|schema| schema.name.as_str().into()).unwrap_or_default(),
            encoding: channel.message_encoding.as_str().into(),
            messages: counts.channel_message_counts.get(&channel.id).copied().unwrap_or(0),
            rate_hz: None,
        });
    }
    // Each entry of the index has its own record. Otherwise, a short index could make the reader
    // read a long record any number of times.
    let mut left_bytes = bytes;
    for index in &summary.metadata_indexes {
        let left = left_bytes.checked_sub(index.length);
        left_bytes = left.ok_or_else(|| io::Error::other("the metadata in its index is longer than the file"))?;
        if let Some((name, entries)) = read_metadata(file, index)? {
            info.metadata.insert(name, entries);
        }
    }
    info.attachments.extend(summary.attachment_indexes.into_iter().map(|index| AttachmentInfo {
        name: index.name.into(),
        media_type: index.media_type.into(),
        bytes: index.data_size,
    }));
    Ok(Some(info))
}

/// Reads a metadata record; `None` if its position is invalid.
fn read_metadata(file: &mut File, index: &MetadataIndex) -> McapResult<Option<(ForeignText, Entries)>> {
    let length = usize::try_from(index.length).unwrap_or(usize::MAX);
    if !(RECORD_HEADER_BYTES..=MAX_RECORD_BYTES).contains(&length) {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(index.offset))?;
    let mut bytes = Vec::new();
    file.take(index.length).read_to_end(&mut bytes)?;
    let (Some(opcode), Some(body)) = (bytes.first(), bytes.get(RECORD_HEADER_BYTES..)) else { return Ok(None) };
    match parse_record(*opcode, body)? {
        Record::Metadata(metadata) => Ok(Some((metadata.name.into(), entries(metadata.metadata)))),
        _ => Ok(None),
    }
}

fn entries(metadata: BTreeMap<String, String>) -> Entries {
    metadata.into_iter().map(|(name, entry)| (name.into(), entry.into())).collect()
}

/// Describes an error. For a decompression error, the description is taken from its cause.
pub(crate) fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(cause) => cause.to_string(),
        other => other.to_string(),
    }
}

/// Number of bytes read from a file, and number of bytes of the decompressed records.
#[derive(Debug, Default)]
pub(crate) struct Sizes {
    read: u64,
    records: u64,
}

impl Sizes {
    /// Adds bytes read from the file.
    pub(crate) fn add_read(&mut self, bytes: usize) {
        self.read += bytes as u64;
    }

    /// Adds a record. Fails if the records are implausibly larger than the file.
    pub(crate) fn add_record(&mut self, bytes: usize) -> McapResult<()> {
        self.records += bytes as u64;
        if self.records > MIN_LIMITED_BYTES && self.records / MAX_RATIO > self.read {
            let Self { read, records } = self;
            let found = format!("{read} bytes decompress to more than {records} bytes");
            return Err(io::Error::other(format!("{found}, {MAX_RATIO} times as many; no flight is so uniform")).into());
        }
        Ok(())
    }
}

/// Reads all records from the start, up to the first damaged one.
fn scan_records(file: &mut File, info: &mut FlightInfo) -> McapResult<()> {
    let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options.with_record_length_limit(MAX_RECORD_BYTES));
    let (mut schemas, mut topic_indexes, mut sizes) = (BTreeMap::new(), BTreeMap::new(), Sizes::default());
    let mut span_ns: Option<[u64; 2]> = None;
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event? {
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                sizes.add_read(read);
                reader.notify_read(read);
                continue;
            }
            LinearReadEvent::Record { opcode, data } => (opcode, data),
        };
        sizes.add_record(data.len())?;
        match parse_record(opcode, data)? {
            Record::Schema { header, .. } => {
                schemas.insert(header.id, ForeignText::from(header.name));
            }
            Record::Channel(channel) if !topic_indexes.contains_key(&channel.id) => {
                topic_indexes.insert(channel.id, info.topics.len());
                info.topics.push(ChannelInfo {
                    topic: channel.topic.into(),
                    schema: schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    encoding: channel.message_encoding.into(),
                    messages: 0,
                    rate_hz: None,
                });
            }
            Record::Message { header, .. } => {
                let index = topic_indexes.get(&header.channel_id);
                if let Some(topic) = index.and_then(|index| info.topics.get_mut(*index)) {
                    topic.messages += 1;
                }
                let [first, last] = span_ns.unwrap_or([header.log_time; 2]);
                let span = [first.min(header.log_time), last.max(header.log_time)];
                (span_ns, info.seconds) = (Some(span), (span[1] - span[0]) as f64 * 1e-9);
            }
            Record::Metadata(metadata) => {
                info.metadata.insert(metadata.name.into(), entries(metadata.metadata));
            }
            Record::Attachment { header: AttachmentHeader { name, media_type, .. }, data, .. } => {
                let (name, media_type) = (name.into(), media_type.into());
                info.attachments.push(AttachmentInfo { name, media_type, bytes: data.len() as u64 });
            }
            _ => {}
        }
    }
    Ok(())
}

impl fmt::Display for FlightInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, bytes, incomplete, seconds, messages, topics, missed, end_reason, attachments, metadata } =
            self;
        let size = *bytes as f64 * 1e-6;
        let messages = pluralize(*messages, "message");
        writeln!(f, "{}: MCAP, {messages} in {seconds:.1} s, {size:.1} MB", foreign::path(file))?;
        if metadata.contains_key(HEADER_METADATA) {
            let [system, host, version, start] =
                ["system", "host", "version", "start_utc"].map(|name| self.header_entry(name));
            writeln!(f, "recorded from {system} on {host}, plumbline {version}, started {start}")?;
        }
        match (incomplete, end_reason) {
            (Some(reason), _) => writeln!(f, "incomplete: {reason}; only the readable part is shown")?,
            (None, Some(reason)) => writeln!(f, "complete; {reason}")?,
            (None, None) => writeln!(f, "complete")?,
        }
        let total: u64 = missed.values().sum();
        writeln!(f, "missed {}", pluralize(total, "message"))?;
        for (topic, count) in missed {
            writeln!(f, "  {topic}: {count}")?;
        }
        write!(f, "{:<14}{:>10}{:>10}  schema", "topic", "messages", "Hz")?;
        for ChannelInfo { topic, schema, messages, rate_hz, .. } in topics {
            let rate = rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
            write!(f, "\n{topic:<14}{messages:>10}{rate:>10}  {schema}")?;
        }
        for AttachmentInfo { name, media_type, bytes } in attachments {
            write!(f, "\nattached: {name}, {media_type}, {bytes} bytes")?;
        }
        Ok(())
    }
}
