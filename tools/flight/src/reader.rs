//! The messages of a flight, one after the other.
//!
//! Input: an MCAP file of ours. Output: messages of a topic in the order in which they were taken down; the launch file. Time: none. Failure: a file
//! that is no flight, or has no launch file, is refused; one that was cut ends where it was.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::Read,
    marker::PhantomData,
    path::{Path, PathBuf},
};

use graph::Topic;
use mcap::{
    McapError, parse_record,
    records::Record,
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use wire::Payload;

use crate::{FlightError, info::RECORD_BYTES, writer::LAUNCH};

/// How the library of our files begins.
const LIBRARY: &str = "plumbline ";

/// Whether the file at `path` is a flight of ours, whatever its name.
pub fn is_flight(path: &Path) -> bool {
    // To open a pipe is to wait for its writer.
    if !path.is_file() {
        return false;
    }
    let Ok(mut records) = Records::open(path) else { return false };
    let is_ours = |record: Record<'_>| matches!(record, Record::Header(header) if header.library.starts_with(LIBRARY));
    matches!(records.next(&mut |record| Some(is_ours(record))), Ok(Some(true)))
}

/// The launch file of a flight.
pub fn launch_file(path: &Path) -> Result<String, FlightError> {
    let mut records = Records::open(path)?;
    let text = records.next(&mut |record| match record {
        Record::Attachment { header, data, .. } if header.name == LAUNCH => {
            Some(String::from_utf8_lossy(&data).into_owned())
        }
        _ => None,
    })?;
    text.ok_or_else(|| FlightError::NoLaunchFile { path: path.to_owned() })
}

/// The messages of a topic.
pub fn messages_of<M: Payload>(path: &Path) -> Result<Messages<M>, FlightError> {
    Ok(Messages { records: Records::open(path)?, channels: BTreeSet::new(), ended: false, payload: PhantomData })
}

/// Messages of a topic, in the order in which they were taken down.
pub struct Messages<M> {
    records: Records,
    /// Those that carry the topic.
    channels: BTreeSet<u16>,
    ended: bool,
    payload: PhantomData<M>,
}

impl<M: Payload> Iterator for Messages<M> {
    type Item = Result<M, FlightError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let Self { records, channels, .. } = self;
        let name = M::TOPIC.name;
        let found = records.next(&mut |record| match record {
            Record::Channel(channel) => {
                if channel.topic.strip_prefix('/') == Some(name) {
                    channels.insert(channel.id);
                }
                None
            }
            Record::Message { header, data } if channels.contains(&header.channel_id) => Some(M::from_bytes(&data)),
            _ => None,
        });
        let path = &self.records.path;
        let message = match found {
            Ok(None) => None,
            Ok(Some(Ok(message))) => Some(Ok(message)),
            Ok(Some(Err(cause))) => Some(Err(FlightError::Message { path: path.clone(), cause })),
            Err(error) => Some(Err(error)),
        };
        self.ended = !matches!(message, Some(Ok(_)));
        message
    }
}

/// When the ticks of a flight were, on the source's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// Samples of the IMU.
    pub samples: u64,
    /// The time of the first.
    pub t_first_ns: i64,
    /// The time of the last.
    pub t_last_ns: i64,
}

/// The span of a flight; `None` of one without samples.
pub fn span(path: &Path) -> Result<Option<Span>, FlightError> {
    let (mut records, mut channels, mut found) = (Records::open(path)?, Channels::default(), None::<Span>);
    let end: Option<()> = records.next(&mut |record| {
        channels.see(&record);
        if let Record::Message { header, .. } = record
            && channels.topic(header.channel_id) == Some(Topic::Imu)
        {
            let t_ns = header.publish_time.cast_signed();
            let span = found.get_or_insert(Span { samples: 0, t_first_ns: t_ns, t_last_ns: t_ns });
            span.samples += 1;
            (span.t_first_ns, span.t_last_ns) = (span.t_first_ns.min(t_ns), span.t_last_ns.max(t_ns));
        }
        None
    })?;
    debug_assert!(end.is_none());
    Ok(found)
}

/// Hands over every message of the topics as it was on the bus, in the order in which they were taken down, with the source's time: of a message
/// that has none, that of the one before it.
pub fn every_message(path: &Path, take: &mut dyn FnMut(i64, Topic, &[u8])) -> Result<(), FlightError> {
    let (mut records, mut channels, mut t_ns) = (Records::open(path)?, Channels::default(), None);
    let refused = records.next(&mut |record| {
        channels.see(&record);
        let Record::Message { header, data } = record else { return None };
        let topic = channels.topic(header.channel_id)?;
        if topic.entry().presence.is_ticked() {
            t_ns = Some(header.publish_time.cast_signed());
        }
        match messages::dispatch!(topic, M => M::from_bytes(&data).map(|message| bytemuck::bytes_of(&message).to_vec())) {
            Ok(bytes) => {
                take(t_ns.unwrap_or(i64::MIN), topic, &bytes);
                None
            }
            Err(cause) => Some(cause),
        }
    })?;
    refused.map_or(Ok(()), |cause| Err(FlightError::Message { path: path.to_owned(), cause }))
}

/// Which topic a channel carries.
#[derive(Default)]
struct Channels(BTreeMap<u16, Topic>);

impl Channels {
    fn see(&mut self, record: &Record<'_>) {
        if let Record::Channel(channel) = record
            && let Some(topic) = channel.topic.strip_prefix('/').and_then(Topic::from_name)
        {
            self.0.insert(channel.id, topic);
        }
    }

    fn topic(&self, channel: u16) -> Option<Topic> {
        self.0.get(&channel).copied()
    }
}

/// The records of a file.
struct Records {
    path: PathBuf,
    file: File,
    reader: LinearReader,
}

impl Records {
    fn open(path: &Path) -> Result<Self, FlightError> {
        let file = File::open(path).map_err(|cause| FlightError::Read { path: path.to_owned(), cause })?;
        let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true);
        let reader = LinearReader::new_with_options(options.with_record_length_limit(RECORD_BYTES));
        Ok(Self { path: path.to_owned(), file, reader })
    }

    /// The first thing that `take` finds in the records that follow; none at the end, or where the file was cut.
    fn next<T>(&mut self, take: &mut dyn FnMut(Record<'_>) -> Option<T>) -> Result<Option<T>, FlightError> {
        let Self { path, file, reader } = self;
        let malformed = |cause: McapError| FlightError::Malformed { path: path.clone(), cause };
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let read = file.read(reader.insert(need));
                    let read = read.map_err(|cause| FlightError::Read { path: path.clone(), cause })?;
                    reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    if let Some(found) = take(parse_record(opcode, data).map_err(malformed)?) {
                        return Ok(Some(found));
                    }
                }
                Err(McapError::UnexpectedEof) => return Ok(None),
                Err(cause) => return Err(malformed(cause)),
            }
        }
        Ok(None)
    }
}
