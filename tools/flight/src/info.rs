//! What a flight holds, from its summary; and of a file that was cut, from its records, as far as they go.
//!
//! Input: an MCAP file. Output: what is in it. Time: that of the file. Failure: what cannot be opened or is no MCAP is refused; a file that
//! ends too early or is damaged is told to be cut, with what was whole before.

use std::{
    collections::BTreeMap,
    fmt,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

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
    writer::{BEGINNING, END, MISSED},
};

/// A record of more bytes is taken for damage.
pub(crate) const RECORD_BYTES: usize = 64 << 20;
/// The opcode and the length before each record.
const HEAD_BYTES: usize = 9;

/// What a flight holds.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FlightInfo {
    /// The file.
    pub file: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// Why it has no summary, as where the recorder was killed; `None` of a file that is whole.
    pub cut: Option<String>,
    /// From the first message to the last, s.
    pub seconds: f64,
    /// Messages, those for viewers among them.
    pub messages: u64,
    /// Each channel.
    pub topics: Vec<ChannelInfo>,
    /// Messages, at least, that were published and are not in the file, by channel.
    pub missed: BTreeMap<String, u64>,
    /// How the recording ended; `None` where that is not known.
    pub end: Option<String>,
    /// What is said of the flight: its system, version, host, beginning.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// What is attached.
    pub attachments: Vec<AttachmentInfo>,
}

/// A channel of a flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Its topic.
    pub topic: String,
    /// The name of the schema; empty where it has none.
    pub schema: String,
    /// How messages are encoded.
    pub encoding: String,
    /// Messages.
    pub messages: u64,
    /// Messages per second of the flight; `None` where that is not known.
    pub rate_hz: Option<f64>,
}

/// What is attached to a flight.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AttachmentInfo {
    /// Its name.
    pub name: String,
    /// What it is.
    pub media_type: String,
    /// Its length.
    pub bytes: u64,
}

impl FlightInfo {
    /// What the file at `path` holds.
    pub fn read(path: &Path) -> Result<Self, FlightError> {
        let unread = |cause| FlightError::Read { path: path.to_owned(), cause };
        let mut file = File::open(path).map_err(unread)?;
        let bytes = file.metadata().map_err(unread)?.len();
        let mut info = match of_summary(&mut file, bytes) {
            Ok(Some(info)) => info,
            not_whole => {
                file.rewind().map_err(unread)?;
                let mut info = Self { cut: Some("it has no summary".into()), ..Self::default() };
                match (of_records(&mut file, &mut info), not_whole) {
                    (Err(McapError::BadMagic), _) => {
                        return Err(FlightError::Malformed { path: path.to_owned(), cause: McapError::BadMagic });
                    }
                    // Of what cannot be decompressed the system knows nothing.
                    (Err(McapError::Io(cause)), _) if cause.raw_os_error().is_some() => return Err(unread(cause)),
                    (Err(McapError::UnexpectedEof), _) => info.cut = Some("it ends before its time".into()),
                    (Err(damage), _) => info.cut = Some(format!("it is damaged: {damage}")),
                    (Ok(()), Err(damage)) => info.cut = Some(format!("its summary is damaged: {damage}")),
                    (Ok(()), Ok(_)) => {}
                }
                info
            }
        };
        (info.file, info.bytes) = (path.to_owned(), bytes);
        info.conclude();
        Ok(info)
    }

    /// Fills in what follows from the rest.
    fn conclude(&mut self) {
        let said = self.metadata.remove(MISSED).unwrap_or_default();
        self.missed = said.into_iter().filter_map(|(topic, count)| Some((topic, count.parse().ok()?))).collect();
        self.end = self.metadata.remove(END).and_then(|mut end| end.remove("how"));
        self.messages = self.topics.iter().map(|topic| topic.messages).sum();
        self.topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        for topic in &mut self.topics {
            let between = topic.messages.saturating_sub(1) as f64;
            topic.rate_hz = Some(between / self.seconds).filter(|rate_hz| rate_hz.is_finite());
        }
    }

    fn said(&self, name: &str) -> &str {
        self.metadata.get(BEGINNING).and_then(|said| said.get(name)).map_or("unknown", String::as_str)
    }
}

/// By the summary at the end; `None` where there is none.
fn of_summary(file: &mut File, bytes: u64) -> McapResult<Option<FlightInfo>> {
    let options = SummaryReaderOptions::default().with_file_size(bytes).with_record_length_limit(RECORD_BYTES);
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
            topic: channel.topic.clone(),
            schema: channel.schema.as_ref().map_or(String::new(), |schema| schema.name.clone()),
            encoding: channel.message_encoding.clone(),
            messages: counts.channel_message_counts.get(&channel.id).copied().unwrap_or(0),
            rate_hz: None,
        });
    }
    for index in &summary.metadata_indexes {
        if let Some((name, said)) = metadata(file, index)? {
            info.metadata.insert(name, said);
        }
    }
    info.attachments.extend(summary.attachment_indexes.into_iter().map(|index| AttachmentInfo {
        name: index.name,
        media_type: index.media_type,
        bytes: index.data_size,
    }));
    Ok(Some(info))
}

/// The metadata of a place in the file.
fn metadata(file: &mut File, index: &MetadataIndex) -> McapResult<Option<(String, BTreeMap<String, String>)>> {
    let length = usize::try_from(index.length).unwrap_or(usize::MAX);
    if !(HEAD_BYTES..=RECORD_BYTES).contains(&length) {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(index.offset))?;
    let mut bytes = Vec::new();
    file.take(index.length).read_to_end(&mut bytes)?;
    let (Some(opcode), Some(body)) = (bytes.first(), bytes.get(HEAD_BYTES..)) else { return Ok(None) };
    match parse_record(*opcode, body)? {
        Record::Metadata(metadata) => Ok(Some((metadata.name, metadata.metadata))),
        _ => Ok(None),
    }
}

/// By every record from the beginning, as far as they are whole.
fn of_records(file: &mut File, info: &mut FlightInfo) -> McapResult<()> {
    let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options.with_record_length_limit(RECORD_BYTES));
    let (mut schemas, mut places) = (BTreeMap::new(), BTreeMap::new());
    let mut span_ns: Option<[u64; 2]> = None;
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event? {
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
                continue;
            }
            LinearReadEvent::Record { opcode, data } => (opcode, data),
        };
        match parse_record(opcode, data)? {
            Record::Schema { header, .. } => {
                schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) if !places.contains_key(&channel.id) => {
                places.insert(channel.id, info.topics.len());
                info.topics.push(ChannelInfo {
                    topic: channel.topic,
                    schema: schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    encoding: channel.message_encoding,
                    messages: 0,
                    rate_hz: None,
                });
            }
            Record::Message { header, .. } => {
                if let Some(topic) = places.get(&header.channel_id).and_then(|place| info.topics.get_mut(*place)) {
                    topic.messages += 1;
                }
                let [first, last] = span_ns.unwrap_or([header.log_time; 2]);
                let span = [first.min(header.log_time), last.max(header.log_time)];
                (span_ns, info.seconds) = (Some(span), (span[1] - span[0]) as f64 * 1e-9);
            }
            Record::Metadata(metadata) => {
                info.metadata.insert(metadata.name, metadata.metadata);
            }
            Record::Attachment { header: AttachmentHeader { name, media_type, .. }, data, .. } => {
                info.attachments.push(AttachmentInfo { name, media_type, bytes: data.len() as u64 });
            }
            _ => {}
        }
    }
    Ok(())
}

/// For people.
impl fmt::Display for FlightInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, bytes, cut, seconds, messages, topics, missed, end, attachments, metadata } = self;
        let size = *bytes as f64 * 1e-6;
        let messages = pluralize(*messages, "message");
        writeln!(f, "{}: MCAP, {messages} in {seconds:.1} s, {size:.1} MB", file.display())?;
        if metadata.contains_key(BEGINNING) {
            let [system, host, version, start] = ["system", "host", "version", "start_utc"].map(|name| self.said(name));
            writeln!(f, "flight of {system} on {host}, plumbline {version}, from {start}")?;
        }
        match (cut, end) {
            (Some(why), _) => writeln!(f, "cut: {why}; what is above and below is in it")?,
            (None, Some(how)) => writeln!(f, "whole; it ended because {how}")?,
            (None, None) => writeln!(f, "whole")?,
        }
        let all: u64 = missed.values().sum();
        writeln!(f, "missed {}", pluralize(all, "message"))?;
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
