//! Recorder of bus messages with its writer thread.
//!
//! Input: messages of topics in order of arrival.
//!
//! Output: the flight file.
//!
//! Time: a message is written to the file within half a second.
//!
//! Failure: recording never waits for the disk, except in lockstep, where the source waits.
//! Messages that do not fit into the queue are counted as missed.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    sync::{
        Arc, OnceLock,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use graph::{Presence, Topic};
use runtime::clock::{monotonic_ns, realtime_offset_ns};
use rustix::time::{ClockId, clock_gettime};
use wire::channel::{FieldOffsets, read_u64};

use crate::{
    FlightError, RecordingSummary,
    chunk_file::ChunkFile,
    error::create_error,
    gaps::Gaps,
    header::{FlightHeader, utc},
    summary::TopicSummary,
    writer::{Writer, write_error},
};

/// Interval at which messages are sent to the writer thread.
const BATCH_INTERVAL: Duration = Duration::from_millis(50);
/// Interval at which the writer thread completes a chunk.
const FLUSH_INTERVAL: Duration = Duration::from_millis(250);
/// Number of bytes after which a chunk is completed early.
const FLUSH_BYTES: usize = 4 << 20;
/// Maximum size of a batch of messages, bytes.
const MAX_BATCH_BYTES: usize = 1 << 20;
/// Maximum number of batches in the queue.
const MAX_QUEUED_BATCHES: usize = 32;
/// Maximum time that the writer thread may take to complete the file.
const DISK_TIMEOUT: Duration = Duration::from_secs(20);
/// Longest time that a lockstep source waits for the writer thread.
const LOCKSTEP_TIMEOUT: Duration = Duration::from_secs(2);
/// Minimum interval between two metadata records that list missed messages.
const MISSED_INTERVAL: Duration = Duration::from_secs(1);
/// Maximum number of names that are tried for a new file.
const MAX_NAMES: u32 = 1000;

/// Required start of a recording, and behaviour of the source when the queue is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingMode {
    /// The recording may start at any tick and the source does not wait. A full queue loses
    /// messages.
    FromAnyTick,
    /// The recording starts at the first tick and the source does not wait. A full queue loses
    /// messages.
    FromFirstTick,
    /// The recording starts at the first tick and the source waits. A full queue delays the source.
    Lockstep,
}

/// Recording in progress.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    mode: RecordingMode,
    intakes: Vec<Option<TopicIntake>>,
    batch: Batch,
    sent_at: Instant,
    commands: SyncSender<WriterCommand>,
    result: Receiver<WriterResult>,
    failure: Arc<OnceLock<String>>,
}

/// Counts of the lost messages of a topic.
#[derive(Debug)]
struct TopicIntake {
    fields: FieldOffsets,
    /// Missed ticks; only for a topic that has a message on every tick.
    gaps: Option<Gaps>,
    /// Number of messages for which the queue had no room. If the topic does not have a message on
    /// every tick, each overflow of the subscriber buffer also counts as one message.
    dropped: u64,
}

#[derive(Debug, Default)]
struct Batch {
    /// Topic, length and time of arrival of each message, in the order of `bytes`.
    messages: Vec<(Topic, u32, u64)>,
    bytes: Vec<u8>,
    /// Total number of missed messages of each topic.
    missed: BTreeMap<Topic, u64>,
}

#[derive(Debug)]
enum WriterCommand {
    Write(Batch),
    Finish { reason: String, report: Option<String>, missed: BTreeMap<Topic, u64> },
}

/// Result of the writer thread.
#[derive(Debug)]
struct WriterResult {
    seconds: f64,
    bytes: u64,
    topics: Vec<TopicSummary>,
}

impl Recorder {
    /// Creates the file and starts the writer thread.
    ///
    /// # Errors
    ///
    /// Returns [`FlightError::Exists`] if the file exists and [`FlightError::Create`] if it cannot
    /// be created.
    pub fn create(
        path: &Path,
        header: &FlightHeader,
        topics: &[Topic],
        mode: RecordingMode,
    ) -> Result<Self, FlightError> {
        let file = ChunkFile::create(path)?;
        let offset_ns = realtime_offset_ns();
        let (commands, receiver) = sync_channel(MAX_QUEUED_BATCHES);
        let (result_sender, result) = sync_channel(1);
        let failure = Arc::new(OnceLock::new());
        let run = {
            let (header, topics, failure, path) = (header.clone(), topics.to_vec(), failure.clone(), path.to_owned());
            move || {
                let result = run_writer(file, &header, &topics, offset_ns, receiver, &path, &failure);
                // The recorder may have given up waiting for the result, so a send error is
                // ignored.
                let _ = result_sender.send(result);
            }
        };
        let thread = thread::Builder::new().name("flight".into()).spawn(run);
        thread.map_err(|cause| create_error(path, cause))?;
        let intake = |topic: Topic| TopicIntake {
            fields: FieldOffsets::new(topic),
            gaps: has_every_tick(topic).then(|| match mode {
                RecordingMode::FromAnyTick => Gaps::default(),
                RecordingMode::FromFirstTick | RecordingMode::Lockstep => Gaps::starting_at(0),
            }),
            dropped: 0,
        };
        let mut intakes: Vec<_> = Topic::ALL.iter().map(|_| None).collect();
        topics.iter().for_each(|topic| intakes[*topic as usize] = Some(intake(*topic)));
        let (batch, sent_at) = (Batch::default(), Instant::now());
        Ok(Self { path: path.to_owned(), mode, intakes, batch, sent_at, commands, result, failure })
    }

    /// Records a message, given as raw bytes from the bus. Topics that are not recorded are
    /// ignored.
    pub fn record(&mut self, topic: Topic, bytes: &[u8]) {
        let Some(intake) = &mut self.intakes[topic as usize] else { return };
        let FieldOffsets { tick, lost_upstream, .. } = intake.fields;
        let read_field = |offset: Option<usize>| offset.and_then(|offset| read_u64(bytes, offset));
        if let Some(gaps) = &mut intake.gaps
            && let Some((tick, lost_upstream)) = read_field(tick).zip(read_field(lost_upstream))
        {
            gaps.record(tick, lost_upstream);
        }
        let has_room = |batch: &Batch| batch.bytes.len() + bytes.len() <= MAX_BATCH_BYTES;
        if !has_room(&self.batch) {
            self.send_batch();
        }
        if has_room(&self.batch) {
            self.batch.messages.push((topic, bytes.len() as u32, monotonic_ns()));
            self.batch.bytes.extend_from_slice(bytes);
        } else if let Some(intake) = &mut self.intakes[topic as usize] {
            intake.dropped += 1;
        }
    }

    /// Notes that the subscriber buffer of `topic` was full, so that messages may have been lost.
    /// For topics that have a message on every tick, lost ticks are counted instead.
    pub fn record_overflow(&mut self, topic: Topic) {
        if let Some(intake) = self.intakes[topic as usize].as_mut().filter(|intake| intake.gaps.is_none()) {
            intake.dropped += 1;
        }
    }

    /// Sends the collected messages to the writer thread if the batch interval has elapsed. Must be
    /// called several times per second.
    pub fn poll(&mut self) {
        if self.sent_at.elapsed() >= BATCH_INTERVAL {
            self.send_batch();
        }
    }

    /// Returns the error that stopped writing, if any.
    pub fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    /// Completes the file with the reason for ending and the run's report.
    ///
    /// Errors are reported in the summary.
    pub fn finish(mut self, reason: &str, report: Option<String>) -> RecordingSummary {
        self.send_batch();
        let finish = WriterCommand::Finish { reason: reason.into(), report, missed: self.missed() };
        let is_sent = self.send(finish, DISK_TIMEOUT).is_ok();
        let result = self.result.recv_timeout(DISK_TIMEOUT).ok();
        let timed_out =
            || FlightError::DiskTimeout { path: self.path.clone(), limit_s: DISK_TIMEOUT.as_secs() }.to_string();
        let error = self.failure.get().cloned().or_else(|| (!is_sent || result.is_none()).then(timed_out));
        let missed = self.missed();
        let WriterResult { seconds, bytes, mut topics } =
            result.unwrap_or(WriterResult { seconds: 0.0, bytes: 0, topics: Vec::new() });
        for topic in &mut topics {
            let is_same = |other: &Topic| other.name() == topic.topic;
            topic.missed = missed.iter().find(|(other, _)| is_same(other)).map_or(0, |(_, count)| *count);
        }
        let messages = topics.iter().map(|topic| topic.messages).sum();
        let missed = missed.values().sum();
        RecordingSummary { file: self.path, seconds, bytes, messages, missed, topics, error }.with_missed_error()
    }

    /// Returns the number of messages missed so far, for each topic that has missed any.
    fn missed(&self) -> BTreeMap<Topic, u64> {
        let count = |intake: &TopicIntake| intake.dropped + intake.gaps.as_ref().map_or(0, Gaps::missed);
        let each = Topic::ALL.iter().zip(&self.intakes);
        each.filter_map(|(topic, intake)| Some((*topic, count(intake.as_ref()?)))).filter(|(_, n)| *n > 0).collect()
    }

    fn send_batch(&mut self) {
        self.sent_at = Instant::now();
        if self.batch.messages.is_empty() {
            return;
        }
        let batch = Batch { missed: self.missed(), ..std::mem::take(&mut self.batch) };
        let timeout = if self.mode == RecordingMode::Lockstep { LOCKSTEP_TIMEOUT } else { Duration::ZERO };
        if let Err(WriterCommand::Write(batch)) = self.send(WriterCommand::Write(batch), timeout) {
            self.batch = batch;
            if self.mode == RecordingMode::Lockstep {
                // The disk is too slow for lockstep, so messages are dropped from now on.
                self.mode = RecordingMode::FromFirstTick;
            }
        }
    }

    /// Sends a command, or returns it if the queue stays full until the timeout. A command to a
    /// stopped writer is discarded.
    fn send(&self, command: WriterCommand, timeout: Duration) -> Result<(), WriterCommand> {
        let (mut command, since) = (command, Instant::now());
        loop {
            command = match self.commands.try_send(command) {
                Ok(()) | Err(TrySendError::Disconnected(_)) => return Ok(()),
                Err(TrySendError::Full(command)) if since.elapsed() >= timeout => return Err(command),
                Err(TrySendError::Full(command)) => command,
            };
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Writes until a finish command arrives, the recorder is dropped or a write fails.
fn run_writer(
    file: ChunkFile,
    header: &FlightHeader,
    topics: &[Topic],
    offset_ns: i64,
    commands: Receiver<WriterCommand>,
    path: &Path,
    failure: &OnceLock<String>,
) -> WriterResult {
    let record_failure = |error: io::Error| {
        // Only the first failure is reported.
        let _ = failure.set(write_error(path, &error).to_string());
    };
    let mut writer = match Writer::create(file, path, header, topics, offset_ns) {
        Ok(writer) => writer,
        Err(error) => {
            record_failure(error);
            return WriterResult { seconds: 0.0, bytes: 0, topics: Vec::new() };
        }
    };
    let finished = process_commands(&mut writer, &commands).map_err(record_failure).is_ok();
    let (mut file, seconds, topics) = writer.into_parts();
    // The MCAP summary is still in the buffer of `file`.
    if finished && let Err(cause) = io::Write::flush(&mut file).and_then(|()| file.sync()) {
        record_failure(cause);
    }
    WriterResult { seconds, bytes: file.written_bytes(), topics }
}

fn process_commands(writer: &mut Writer, commands: &Receiver<WriterCommand>) -> io::Result<()> {
    let (mut flushed, mut unflushed) = (Instant::now(), 0);
    let (mut missed_written_at, mut missed) = (None::<Instant>, BTreeMap::new());
    loop {
        match commands.recv_timeout(FLUSH_INTERVAL.saturating_sub(flushed.elapsed())) {
            Ok(WriterCommand::Write(batch)) => {
                let mut bytes = batch.bytes.as_slice();
                for (topic, len, received_ns) in &batch.messages {
                    let (message, rest) = bytes.split_at((*len as usize).min(bytes.len()));
                    writer.write(*topic, message, *received_ns)?;
                    bytes = rest;
                }
                unflushed += batch.bytes.len();
                let is_due = missed_written_at.is_none_or(|written_at| written_at.elapsed() >= MISSED_INTERVAL);
                if batch.missed != missed && is_due {
                    writer.write_missed(&batch.missed)?;
                    (missed_written_at, missed) = (Some(Instant::now()), batch.missed);
                }
            }
            Ok(WriterCommand::Finish { reason, report, missed: total }) => {
                if total != missed {
                    writer.write_missed(&total)?;
                }
                return writer.finish(&reason, report.as_deref());
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writer.finish("recorder dropped", None),
        }
        if flushed.elapsed() >= FLUSH_INTERVAL || unflushed >= FLUSH_BYTES {
            if unflushed > 0 {
                writer.flush()?;
            }
            (flushed, unflushed) = (Instant::now(), 0);
        }
    }
}

/// Returns an unused path in `folder`. The name consists of the system name and the current time,
/// UTC.
///
/// # Errors
///
/// Returns [`FlightError::Exists`] if all candidate names are taken.
pub fn unused_path(folder: &Path, system: &str) -> Result<PathBuf, FlightError> {
    let now = utc(clock_gettime(ClockId::Realtime).tv_sec, ["", "T", ""]);
    let name =
        |n: u32| folder.join(format!("{system}-{now}{}.mcap", if n > 1 { format!("-{n}") } else { String::new() }));
    let is_free = |path: &PathBuf| fs::symlink_metadata(path).is_err();
    (1..MAX_NAMES).map(name).find(is_free).ok_or_else(|| FlightError::Exists { path: name(MAX_NAMES) })
}

fn has_every_tick(topic: Topic) -> bool {
    topic.entry().presence == Presence::EveryTick
}
