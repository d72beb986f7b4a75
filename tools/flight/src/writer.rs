//! The MCAP file: a channel for each topic, those of viewers, metadata, attachments.
//!
//! Input: messages as bytes of the bus. Output: chunks, each in the file as a whole. Time: [`Clocks`]. Failure: the first one ends the file.

use std::{borrow::Cow, collections::BTreeMap, io, path::Path};

use graph::Topic;
use mcap::{Attachment, Compression, McapError, McapResult, WriteOptions, records::MessageHeader, records::Metadata};
use messages::layout;
use wire::channel::{self, Clocks, Encoder, encode_for_viewers};

use crate::{FlightError, Heading, Stamps, chunk_file::ChunkFile, summary::TopicSummary};

/// A chunk of so many bytes, uncompressed, ends before its time.
const CHUNK_BYTES: u64 = 1 << 20;
/// What goes with the file at the beginning, at the end, and where messages were missed.
pub(crate) const BEGINNING: &str = "plumbline";
pub(crate) const END: &str = "end";
pub(crate) const MISSED: &str = "missed";
/// The launch file, what came of it with the command line, and the report of the run, as attachments.
pub(crate) const LAUNCH: &str = "launch.toml";
pub(crate) const CONFIG: &str = "config.json";
pub(crate) const REPORT: &str = "report.json";

pub(crate) struct Writer {
    mcap: mcap::Writer<ChunkFile>,
    clocks: Clocks,
    channels: Vec<Channel>,
    /// The places of topics among the channels.
    places: Vec<Option<usize>>,
    /// The channels for viewers.
    viewers: Vec<(u16, channel::Channel)>,
    /// First and last message, CLOCK_REALTIME, ns.
    span_ns: Option<[u64; 2]>,
}

struct Channel {
    id: u16,
    topic: Topic,
    encoder: Encoder,
    messages: u64,
    /// Of these, those in chunks that are in the file.
    in_file: u64,
}

impl Writer {
    /// Puts everything but messages into the file.
    pub(crate) fn begin(file: ChunkFile, heading: &Heading, topics: &[Topic], clocks: Clocks) -> McapResult<Self> {
        let library = format!("plumbline {}", heading.version);
        let options = WriteOptions::new().profile("").library(library).compression(Some(Compression::Lz4));
        let mut mcap = options.chunk_size(Some(CHUNK_BYTES)).disable_seeking(true).create(file)?;
        mcap.write_metadata(&Metadata { name: BEGINNING.into(), metadata: heading.entries(clocks) })?;
        let start_ns = now_ns(clocks);
        if let Some(launch) = &heading.launch {
            mcap.attach(&attachment(LAUNCH, "application/toml", launch.as_bytes(), start_ns))?;
        }
        mcap.attach(&attachment(CONFIG, "application/json", heading.config.as_bytes(), start_ns))?;
        let mut channels = Vec::new();
        let mut places = vec![None; Topic::ALL.len()];
        let mut viewers = Vec::new();
        for named in channel::channels(topics) {
            if named.is_for_viewers {
                viewers.push((add_channel(&mut mcap, &named, &BTreeMap::new())?, named));
                continue;
            }
            let about = BTreeMap::from([("type".into(), layout(named.topic).name.into())]);
            let id = add_channel(&mut mcap, &named, &about)?;
            places[named.topic as usize] = Some(channels.len());
            channels.push(Channel {
                id,
                topic: named.topic,
                encoder: Encoder::new(named.topic),
                messages: 0,
                in_file: 0,
            });
        }
        mcap.flush()?;
        Ok(Self { mcap, clocks, channels, places, viewers, span_ns: None })
    }

    /// Puts a message into the chunk under way; `taken_ns` is when it was taken, CLOCK_MONOTONIC.
    pub(crate) fn write(&mut self, topic: Topic, bytes: &[u8], taken_ns: u64) -> McapResult<()> {
        let Self { mcap, clocks, channels, places, viewers, span_ns } = self;
        let Some(channel) = places[topic as usize].and_then(|place| channels.get_mut(place)) else { return Ok(()) };
        let Some((data, stamps)) = channel.encoder.encode(bytes, taken_ns, *clocks) else { return Ok(()) };
        put(mcap, channel.id, stamps, &data)?;
        channel.messages += 1;
        let [first, last] = span_ns.unwrap_or([stamps.log_ns; 2]);
        *span_ns = Some([first.min(stamps.log_ns), last.max(stamps.log_ns)]);
        for (id, named) in viewers.iter().filter(|(_, named)| named.topic == topic) {
            if let Some(form) = encode_for_viewers(&named.name, bytes, stamps.log_ns) {
                put(mcap, *id, stamps, &form)?;
            }
        }
        Ok(())
    }

    /// Says that messages were missed: how many of each topic so far.
    pub(crate) fn missed(&mut self, missed: &BTreeMap<Topic, u64>) -> McapResult<()> {
        let entries = missed.iter().map(|(topic, count)| (format!("/{}", topic.name()), count.to_string()));
        self.mcap.write_metadata(&Metadata { name: MISSED.into(), metadata: entries.collect() })
    }

    /// Ends the chunk: what was written is in the file.
    pub(crate) fn flush(&mut self) -> McapResult<()> {
        self.mcap.flush()?;
        self.channels.iter_mut().for_each(|channel| channel.in_file = channel.messages);
        Ok(())
    }

    /// Ends the file with how the run ended and its report, if there is one, and with the summary of what it holds.
    pub(crate) fn finish(&mut self, how: &str, report: Option<&str>) -> McapResult<()> {
        let entries = [("how".to_owned(), how.to_owned())];
        self.mcap.write_metadata(&Metadata { name: END.into(), metadata: entries.into() })?;
        if let Some(report) = report {
            let end_ns = now_ns(self.clocks);
            self.mcap.attach(&attachment(REPORT, "application/json", report.as_bytes(), end_ns))?;
        }
        self.flush()?;
        self.mcap.finish()?;
        Ok(())
    }

    /// The file with what is still to be put into it, if it has not ended; how long the flight was, s; and its messages by topic.
    pub(crate) fn into_file(self) -> (ChunkFile, f64, Vec<TopicSummary>) {
        let topics = self.channels.iter().map(|channel| TopicSummary {
            topic: channel.topic.name(),
            messages: channel.in_file,
            missed: 0,
        });
        let topics = topics.collect();
        (self.mcap.into_inner(), self.span_ns.map_or(0.0, |[first, last]| (last - first) as f64 * 1e-9), topics)
    }
}

/// CLOCK_REALTIME as the file has it, ns.
pub(crate) fn now_ns(clocks: Clocks) -> u64 {
    runtime::clock::monotonic_ns().saturating_add_signed(clocks.offset_ns)
}

/// What the system answered, without what the library says around it.
pub(crate) fn ended(path: &Path, error: McapError) -> FlightError {
    let cause = match error {
        McapError::Io(cause) => cause.to_string(),
        other => other.to_string(),
    };
    FlightError::Ends { path: path.to_owned(), cause }
}

fn add_channel(
    mcap: &mut mcap::Writer<ChunkFile>,
    channel::Channel { name, schema, .. }: &channel::Channel,
    about: &BTreeMap<String, String>,
) -> McapResult<u16> {
    let no_schema = || io::Error::other(format!("there is no schema of the name {schema}"));
    let descriptors = wire::schema::descriptors_for(schema).ok_or_else(no_schema)?;
    let schema = mcap.add_schema(schema, "protobuf", &descriptors)?;
    mcap.add_channel(schema, name, "protobuf", about)
}

fn put(mcap: &mut mcap::Writer<ChunkFile>, channel_id: u16, stamps: Stamps, data: &[u8]) -> McapResult<()> {
    let Stamps { log_ns, source_ns, sequence } = stamps;
    mcap.write_to_known_channel(
        &MessageHeader { channel_id, sequence, log_time: log_ns, publish_time: source_ns },
        data,
    )
}

fn attachment<'a>(name: &str, media_type: &str, data: &'a [u8], t_ns: u64) -> Attachment<'a> {
    Attachment {
        log_time: t_ns,
        create_time: t_ns,
        name: name.into(),
        media_type: media_type.into(),
        data: Cow::Borrowed(data),
    }
}
