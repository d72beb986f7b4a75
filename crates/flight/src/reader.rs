//! Messages of a flight in file order.
//!
//! Input: an MCAP file recorded by Plumbline.
//!
//! Output: messages of one or all topics in the order of recording, and the launch file.
//!
//! Failure: files that are not flights or lack a launch file are rejected. A truncated file ends at
//! the truncation.

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

use crate::{
    FlightError,
    info::{MAX_RECORD_BYTES, Sizes, reason},
    writer::LAUNCH_ATTACHMENT,
};

/// Prefix of the MCAP library field in files written by Plumbline.
const LIBRARY_PREFIX: &str = "plumbline ";

/// Returns `true` if the file at `path` is a Plumbline flight. The file name is ignored.
pub fn is_flight(path: &Path) -> bool {
    // Only regular files are opened, because opening a pipe would block until it has a writer.
    if !path.is_file() {
        return false;
    }
    let Ok(mut records) = Records::open(path) else { return false };
    let is_ours =
        |record: Record<'_>| matches!(record, Record::Header(header) if header.library.starts_with(LIBRARY_PREFIX));
    matches!(records.find_map(&mut |record| Some(is_ours(record))), Ok(Some(true)))
}

/// Returns the launch file attached to a flight.
///
/// # Errors
///
/// Returns [`FlightError::NoLaunchFile`] if no launch file is attached, or another error if the
/// file cannot be read.
pub fn read_launch_file(path: &Path) -> Result<String, FlightError> {
    let mut records = Records::open(path)?;
    let text = records.find_map(&mut |record| match record {
        Record::Attachment { header, data, .. } if header.name == LAUNCH_ATTACHMENT => {
            Some(String::from_utf8_lossy(&data).into_owned())
        }
        _ => None,
    })?;
    text.ok_or_else(|| FlightError::NoLaunchFile { path: path.to_owned() })
}

/// Opens a flight and returns an iterator over the messages of the topic of `M`.
///
/// # Errors
///
/// Returns [`FlightError::Read`] if the file cannot be opened.
pub fn read_messages<M: Payload>(path: &Path) -> Result<Messages<M>, FlightError> {
    Ok(Messages { records: Records::open(path)?, channels: BTreeSet::new(), ended: false, payload: PhantomData })
}

/// Iterator over the messages of a topic in the order of recording. Ends after the first error.
pub struct Messages<M> {
    records: Records,
    /// Channels of the topic.
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
        let found = records.find_map(&mut |record| match record {
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
            Ok(Some(Err(cause))) => Some(Err(FlightError::InvalidMessage { path: path.clone(), cause })),
            Err(error) => Some(Err(error)),
        };
        self.ended = !matches!(message, Some(Ok(_)));
        message
    }
}

/// Number and time span of the ticks of a flight, on the source's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TickSpan {
    /// Number of IMU samples.
    pub samples: u64,
    /// Time of the first sample.
    pub t_first_ns: i64,
    /// Time of the last sample.
    pub t_last_ns: i64,
}

/// Returns the tick span of a flight, or `None` if it has no IMU samples.
///
/// # Errors
///
/// Returns an error if the file cannot be opened or is damaged.
pub fn read_span(path: &Path) -> Result<Option<TickSpan>, FlightError> {
    let (mut records, mut channels, mut found) = (Records::open(path)?, Channels::default(), None::<TickSpan>);
    let end: Option<()> = records.find_map(&mut |record| {
        channels.observe(&record);
        if let Record::Message { header, .. } = record
            && channels.topic(header.channel_id) == Some(Topic::Imu)
        {
            let t_ns = header.publish_time.cast_signed();
            let span = found.get_or_insert(TickSpan { samples: 0, t_first_ns: t_ns, t_last_ns: t_ns });
            span.samples += 1;
            (span.t_first_ns, span.t_last_ns) = (span.t_first_ns.min(t_ns), span.t_last_ns.max(t_ns));
        }
        None
    })?;
    debug_assert!(end.is_none());
    Ok(found)
}

/// Calls `visit` for each message in the order of recording. The arguments are the source time, the
/// topic and the message bytes.
///
/// References have the time of their sample. The messages of other topics without ticks get the
/// time of the latest message with a tick, or `i64::MIN` before the first such message. Unknown
/// topics are skipped.
///
/// # Errors
///
/// Returns an error if the file cannot be opened or is damaged, or if a message cannot be decoded.
pub fn for_each_message(path: &Path, visit: &mut dyn FnMut(i64, Topic, &[u8])) -> Result<(), FlightError> {
    let (mut records, mut channels, mut newest_ns) = (Records::open(path)?, Channels::default(), i64::MIN);
    let error = records.find_map(&mut |record| {
        channels.observe(&record);
        let Record::Message { header, data } = record else { return None };
        let topic = channels.topic(header.channel_id)?;
        let publish_ns = header.publish_time.cast_signed();
        if topic.entry().presence.is_ticked() {
            newest_ns = publish_ns;
        }
        // The recorder may receive a reference long after the sample of its tick.
        let t_ns = if topic == Topic::Reference { publish_ns } else { newest_ns };
        match messages::dispatch!(topic, M => M::from_bytes(&data).map(|message| bytemuck::bytes_of(&message).to_vec()))
        {
            Ok(bytes) => {
                visit(t_ns, topic, &bytes);
                None
            }
            Err(cause) => Some(cause),
        }
    })?;
    error.map_or(Ok(()), |cause| Err(FlightError::InvalidMessage { path: path.to_owned(), cause }))
}

/// Topics by channel.
#[derive(Default)]
struct Channels(BTreeMap<u16, Topic>);

impl Channels {
    fn observe(&mut self, record: &Record<'_>) {
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

/// Reader for the records of a file.
struct Records {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    sizes: Sizes,
}

impl Records {
    fn open(path: &Path) -> Result<Self, FlightError> {
        let file = File::open(path).map_err(|cause| FlightError::Read { path: path.to_owned(), cause })?;
        let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true);
        let reader = LinearReader::new_with_options(options.with_record_length_limit(MAX_RECORD_BYTES));
        Ok(Self { path: path.to_owned(), file, reader, sizes: Sizes::default() })
    }

    /// Calls `visit` for the next records until it returns `Some`.
    ///
    /// Returns that value, or `None` at the end of the file or at a truncation.
    fn find_map<T>(&mut self, visit: &mut dyn FnMut(Record<'_>) -> Option<T>) -> Result<Option<T>, FlightError> {
        let Self { path, file, reader, sizes } = self;
        let malformed = |cause: McapError| FlightError::Malformed { path: path.clone(), cause: reason(&cause).into() };
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let read = file.read(reader.insert(need));
                    let read = read.map_err(|cause| FlightError::Read { path: path.clone(), cause })?;
                    sizes.add_read(read);
                    reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    sizes.add_record(data.len()).map_err(malformed)?;
                    if let Some(found) = visit(parse_record(opcode, data).map_err(malformed)?) {
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
