//! MCAP writer: a channel for each topic, channels for viewers, metadata, attachments.
//!
//! Input: messages, as raw bytes from the bus.
//!
//! Output: complete chunks of the file.
//!
//! Time: see [`Stamps`].
//!
//! Failure: no more data is written after the first error.

use std::{collections::BTreeMap, io, path::Path};

use graph::Topic;
use mcap::records::{AttachmentHeader, MessageHeader};
use messages::layout;
use wire::channel::{self, Encoder, encode_for_viewers};

use crate::{
    FlightError, Stamps,
    chunk_file::ChunkFile,
    header::{FlightHeader, now_ns},
    mcap_file::McapFile,
    summary::TopicSummary,
};

/// Name of the metadata record at the start.
pub(crate) const HEADER_METADATA: &str = "plumbline";
/// Name of the metadata record at the end.
pub(crate) const END_METADATA: &str = "end";
/// Name of the metadata records that list missed messages.
pub(crate) const MISSED_METADATA: &str = "missed";
/// Name of the attached launch file.
pub(crate) const LAUNCH_ATTACHMENT: &str = "launch.toml";
/// Name of the attached effective configuration.
pub(crate) const CONFIG_ATTACHMENT: &str = "config.json";
/// Name of the attached report of the run.
pub(crate) const REPORT_ATTACHMENT: &str = "report.json";

pub(crate) struct Writer {
    mcap: McapFile,
    /// CLOCK_REALTIME minus CLOCK_MONOTONIC, measured once at the start, ns.
    offset_ns: i64,
    channels: Vec<Channel>,
    /// Index into `channels` by topic.
    channel_indexes: Vec<Option<usize>>,
    /// Channels for viewers, with their MCAP ids.
    viewers: Vec<(u16, channel::Channel)>,
    /// Times of the first and the last message, CLOCK_REALTIME, ns.
    span_ns: Option<[u64; 2]>,
}

struct Channel {
    id: u16,
    topic: Topic,
    encoder: Encoder,
    messages: u64,
    /// Number of messages in chunks that have been written to the file.
    flushed: u64,
}

impl Writer {
    /// Creates the MCAP file with header metadata, attachments, schemas and channels.
    pub(crate) fn create(
        file: ChunkFile,
        path: &Path,
        header: &FlightHeader,
        topics: &[Topic],
        offset_ns: i64,
    ) -> io::Result<Self> {
        let library = format!("plumbline {}", header.version);
        let mut mcap = McapFile::create(file, path, &library)?;
        mcap.write_metadata(HEADER_METADATA, &header.metadata(offset_ns))?;
        let start_ns = now_ns(offset_ns);
        if let Some(launch) = &header.launch {
            mcap.attach(&attachment(LAUNCH_ATTACHMENT, "application/toml", start_ns), launch.as_bytes())?;
        }
        mcap.attach(&attachment(CONFIG_ATTACHMENT, "application/json", start_ns), header.config.as_bytes())?;
        let mut channels = Vec::new();
        let mut channel_indexes = vec![None; Topic::ALL.len()];
        let mut viewers = Vec::new();
        for channel in channel::channels(topics) {
            if channel.is_for_viewers {
                viewers.push((add_channel(&mut mcap, &channel, &BTreeMap::new())?, channel));
                continue;
            }
            let metadata = BTreeMap::from([("type".into(), layout(channel.topic).name.into())]);
            let id = add_channel(&mut mcap, &channel, &metadata)?;
            channel_indexes[channel.topic as usize] = Some(channels.len());
            channels.push(Channel {
                id,
                topic: channel.topic,
                encoder: Encoder::new(channel.topic),
                messages: 0,
                flushed: 0,
            });
        }
        mcap.flush()?;
        Ok(Self { mcap, offset_ns, channels, channel_indexes, viewers, span_ns: None })
    }

    /// Adds a message that arrived at `received_ns` (CLOCK_MONOTONIC) to the current chunk.
    pub(crate) fn write(&mut self, topic: Topic, bytes: &[u8], received_ns: u64) -> io::Result<()> {
        let Self { mcap, offset_ns, channels, channel_indexes, viewers, span_ns } = self;
        let Some(channel) = channel_indexes[topic as usize].and_then(|index| channels.get_mut(index)) else {
            return Ok(());
        };
        let Some((data, stamps)) = channel.encoder.encode(bytes, received_ns, *offset_ns) else { return Ok(()) };
        write_message(mcap, channel.id, stamps, &data)?;
        channel.messages += 1;
        let [first, last] = span_ns.unwrap_or([stamps.log_ns; 2]);
        *span_ns = Some([first.min(stamps.log_ns), last.max(stamps.log_ns)]);
        for (id, channel) in viewers.iter().filter(|(_, channel)| channel.topic == topic) {
            if let Some(data) = encode_for_viewers(&channel.name, bytes, stamps.log_ns) {
                write_message(mcap, *id, stamps, &data)?;
            }
        }
        Ok(())
    }

    /// Writes a metadata record with the number of messages missed so far on each topic.
    pub(crate) fn write_missed(&mut self, missed: &BTreeMap<Topic, u64>) -> io::Result<()> {
        let entries = missed.iter().map(|(topic, count)| (format!("/{}", topic.name()), count.to_string()));
        self.mcap.write_metadata(MISSED_METADATA, &entries.collect())
    }

    /// Completes the current chunk and writes it to the file.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.mcap.flush()?;
        self.channels.iter_mut().for_each(|channel| channel.flushed = channel.messages);
        Ok(())
    }

    /// Writes the reason for ending, the optional report and the MCAP summary, which completes the
    /// file.
    pub(crate) fn finish(&mut self, reason: &str, report: Option<&str>) -> io::Result<()> {
        let entries = [("reason".to_owned(), reason.to_owned())];
        self.mcap.write_metadata(END_METADATA, &entries.into())?;
        if let Some(report) = report {
            let end_ns = now_ns(self.offset_ns);
            self.mcap.attach(&attachment(REPORT_ATTACHMENT, "application/json", end_ns), report.as_bytes())?;
        }
        self.flush()?;
        self.mcap.finish()
    }

    /// Returns the file, the duration of the flight in seconds, and the number of flushed messages
    /// by topic. Data that were not flushed are not counted, although the file may contain them.
    pub(crate) fn into_parts(self) -> (ChunkFile, f64, Vec<TopicSummary>) {
        let topics = self.channels.iter().map(|channel| TopicSummary {
            topic: channel.topic.name(),
            messages: channel.flushed,
            missed: 0,
        });
        let topics = topics.collect();
        (self.mcap.into_inner(), self.span_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9), topics)
    }
}

/// Converts a write error.
pub(crate) fn write_error(path: &Path, cause: &io::Error) -> FlightError {
    FlightError::WriteFailed { path: path.to_owned(), cause: cause.to_string() }
}

fn add_channel(
    mcap: &mut McapFile,
    channel::Channel { name, schema, .. }: &channel::Channel,
    metadata: &BTreeMap<String, String>,
) -> io::Result<u16> {
    let no_schema = || io::Error::other(format!("no schema named {schema}"));
    let descriptors = wire::schema::descriptors_for(schema).ok_or_else(no_schema)?;
    mcap.add_channel(name, (schema, &descriptors), metadata)
}

fn write_message(mcap: &mut McapFile, channel_id: u16, stamps: Stamps, data: &[u8]) -> io::Result<()> {
    let Stamps { log_ns, source_ns, sequence } = stamps;
    mcap.write_message(&MessageHeader { channel_id, sequence, log_time: log_ns, publish_time: source_ns }, data)
}

fn attachment(name: &str, media_type: &str, t_ns: u64) -> AttachmentHeader {
    AttachmentHeader { log_time: t_ns, create_time: t_ns, name: name.into(), media_type: media_type.into() }
}
