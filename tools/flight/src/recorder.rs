//! What a reader hands messages to, and the thread that writes them.
//!
//! Input: messages of topics in their order. Output: the file. Time: what is handed over is in the file half a second later. Failure: the
//! reader never waits for the disk, but in lockstep, where the source waits for it. What the queue does not hold is counted as missed.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, OnceLock,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use graph::{Presence, Topic};
use launch::Output;
use mcap::McapResult;
use runtime::{
    ServiceConfig,
    clock::{monotonic_ns, realtime_offset_ns},
};
use rustix::time::{ClockId, clock_gettime};
use time::OffsetDateTime;
use wire::channel::{Clocks, FieldOffsets, read_u64};

use crate::{
    FlightError, Summary,
    chunk_file::ChunkFile,
    error::creating,
    gaps::Gaps,
    summary::TopicSummary,
    writer::{Writer, ended, now_ns},
};

/// How often what was taken is handed to the thread that writes, and how often that puts a chunk into the file.
const HAND_OVER: Duration = Duration::from_millis(50);
const FLUSH: Duration = Duration::from_millis(250);
/// A chunk is put into the file before its time after so many bytes.
const FLUSH_BYTES: usize = 4 << 20;
/// Bytes of messages that are handed over at once, and how many times so many may wait.
const BATCH_BYTES: usize = 1 << 20;
const BATCHES: usize = 32;
/// How long the disk may take nothing at the end, and how long a source in lockstep waits for it.
const DISK_LIMIT: Duration = Duration::from_secs(20);
const LOCKSTEP_LIMIT: Duration = Duration::from_secs(2);
/// Between two records of what was missed.
const TOLD: Duration = Duration::from_secs(1);
/// Names that are tried for a file.
const NAMES: u32 = 1000;

/// What is said of a flight at its beginning.
#[derive(Debug, Clone)]
pub struct Heading {
    /// The version of Plumbline.
    pub version: &'static str,
    /// The system's name.
    pub system: String,
    /// The machine's name.
    pub host: String,
    /// The launch file's path, where it is known.
    pub launch_file: Option<PathBuf>,
    /// The launch file as it is written, where it is known.
    pub launch: Option<String>,
    /// What every service was told, with all that the launch file leaves to its defaults: JSON.
    pub config: String,
    /// Ticks per second of the source's time.
    pub rate_hz: f64,
    /// In which frame the attitude left the system; the topics of the flight are in its own.
    pub output: Output,
}

/// What the reader of the bus is to the source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// It came later, or the source does not wait: a full queue costs messages.
    Live,
    /// It is there from the first tick on and the source does not wait.
    FromTheFirst,
    /// It is there from the first tick on and the source waits for it: a full queue costs time.
    Lockstep,
}

/// A recording under way.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    mode: Mode,
    intakes: Vec<Option<Intake>>,
    batch: Batch,
    handed_over: Instant,
    queue: SyncSender<Order>,
    ended: Receiver<Ended>,
    failure: Arc<OnceLock<String>>,
}

/// What is known of a topic before its messages are written.
#[derive(Debug)]
struct Intake {
    fields: FieldOffsets,
    /// Of a topic with every tick.
    gaps: Option<Gaps>,
    /// Messages that the queue had no room for, and of a topic without every tick the times at which its own buffer was full.
    dropped: u64,
}

#[derive(Debug, Default)]
struct Batch {
    messages: Vec<(Topic, u32, u64)>,
    bytes: Vec<u8>,
    /// What was missed so far.
    missed: BTreeMap<Topic, u64>,
}

#[derive(Debug)]
enum Order {
    Write(Batch),
    Finish { how: String, report: Option<String>, missed: BTreeMap<Topic, u64> },
}

/// What the thread that writes says at its end.
#[derive(Debug)]
struct Ended {
    seconds: f64,
    bytes: u64,
    topics: Vec<TopicSummary>,
}

impl Heading {
    /// The heading of a system of this configuration.
    pub fn new(version: &'static str, config: &ServiceConfig) -> Self {
        Self {
            version,
            system: config.launch.name.clone(),
            host: fs::read_to_string("/proc/sys/kernel/hostname").map_or("unknown".into(), |host| host.trim().into()),
            launch_file: None,
            launch: None,
            // Numbers, strings, lists and maps with names always serialise.
            config: serde_json::to_string_pretty(config).unwrap_or_default(),
            rate_hz: config.rate_hz,
            output: config.launch.output,
        }
    }

    pub(crate) fn entries(&self, clocks: Clocks) -> BTreeMap<String, String> {
        let Self { version, system, host, launch_file, rate_hz, output, .. } = self;
        let entries = [
            ("version", Some((*version).to_owned())),
            ("system", Some(system.clone())),
            ("host", Some(host.clone())),
            ("launch_file", launch_file.as_ref().map(|path| path.display().to_string())),
            ("start_utc", Some(utc((now_ns(clocks) / 1_000_000_000).cast_signed(), ["-", "T", ":"]))),
            ("rate_hz", Some(rate_hz.to_string())),
            ("realtime_less_monotonic_ns", Some(clocks.offset_ns.to_string())),
            ("world", Some("east, north, up where the course is true, else turned about the vertical".to_owned())),
            ("body", Some("forward, left, up".to_owned())),
            ("topics_frame", Some(Output::default().frame.name().to_owned())),
            ("output_frame", Some(output.frame.name().to_owned())),
            ("output_quaternion", Some(output.quaternion.name().to_owned())),
        ];
        entries.into_iter().filter_map(|(name, entry)| Some((name.to_owned(), entry?))).collect()
    }
}

impl Recorder {
    /// Begins a file with these topics.
    pub fn begin(path: &Path, heading: &Heading, topics: &[Topic], mode: Mode) -> Result<Self, FlightError> {
        let file = ChunkFile::create(path)?;
        let clocks = Clocks { offset_ns: realtime_offset_ns(), rate_hz: heading.rate_hz };
        let (queue, orders) = sync_channel(BATCHES);
        let (done, ended) = sync_channel(1);
        let failure = Arc::new(OnceLock::new());
        let writing = {
            let (heading, topics, failure, path) = (heading.clone(), topics.to_vec(), failure.clone(), path.to_owned());
            move || {
                let ended = work(file, &heading, &topics, clocks, orders, &path, &failure);
                // Whoever asked for the end may have waited long enough.
                let _ = done.send(ended);
            }
        };
        let thread = thread::Builder::new().name("flight".into()).spawn(writing);
        thread.map_err(|cause| creating(path, cause))?;
        let intake = |topic: Topic| Intake {
            fields: FieldOffsets::new(topic),
            gaps: has_every_tick(topic).then(|| match mode {
                Mode::Live => Gaps::default(),
                Mode::FromTheFirst | Mode::Lockstep => Gaps::from(0),
            }),
            dropped: 0,
        };
        let mut intakes: Vec<_> = Topic::ALL.iter().map(|_| None).collect();
        topics.iter().for_each(|topic| intakes[*topic as usize] = Some(intake(*topic)));
        let (batch, handed_over) = (Batch::default(), Instant::now());
        Ok(Self { path: path.to_owned(), mode, intakes, batch, handed_over, queue, ended, failure })
    }

    /// Takes a message of a topic.
    pub fn take(&mut self, topic: Topic, bytes: &[u8]) {
        let Some(intake) = &mut self.intakes[topic as usize] else { return };
        let FieldOffsets { tick, lost_upstream, .. } = intake.fields;
        let at = |offset: Option<usize>| offset.and_then(|offset| read_u64(bytes, offset));
        if let Some(gaps) = &mut intake.gaps
            && let Some((tick, lost_upstream)) = at(tick).zip(at(lost_upstream))
        {
            gaps.take(tick, lost_upstream);
        }
        let has_room = |batch: &Batch| batch.bytes.len() + bytes.len() <= BATCH_BYTES;
        if !has_room(&self.batch) {
            self.hand_over();
        }
        if has_room(&self.batch) {
            self.batch.messages.push((topic, bytes.len() as u32, monotonic_ns()));
            self.batch.bytes.extend_from_slice(bytes);
        } else if let Some(intake) = &mut self.intakes[topic as usize] {
            intake.dropped += 1;
        }
    }

    /// The reader's own buffer of the topic was full, so that messages may have been overwritten. Ticks tell how many, where there are any.
    pub fn overflowed(&mut self, topic: Topic) {
        if let Some(intake) = self.intakes[topic as usize].as_mut().filter(|intake| intake.gaps.is_none()) {
            intake.dropped += 1;
        }
    }

    /// Hands over what was taken, when it is time; to be called several times a second.
    pub fn look(&mut self) {
        if self.handed_over.elapsed() >= HAND_OVER {
            self.hand_over();
        }
    }

    /// Why nothing more is written.
    pub fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    /// Ends the file with how the run ended and its report; what came of it.
    pub fn end(mut self, how: &str, report: Option<String>) -> Summary {
        self.hand_over();
        let finish = Order::Finish { how: how.into(), report, missed: self.missed() };
        let is_asked = self.send(finish, DISK_LIMIT).is_ok();
        let ended = self.ended.recv_timeout(DISK_LIMIT).ok();
        let stuck = || FlightError::Stuck { path: self.path.clone(), limit_s: DISK_LIMIT.as_secs() }.to_string();
        let error = self.failure.get().cloned().or_else(|| (!is_asked || ended.is_none()).then(stuck));
        let missed = self.missed();
        let Ended { seconds, bytes, mut topics } =
            ended.unwrap_or(Ended { seconds: 0.0, bytes: 0, topics: Vec::new() });
        for topic in &mut topics {
            let of = |it: &Topic| it.name() == topic.topic;
            topic.missed = missed.iter().find(|(it, _)| of(it)).map_or(0, |(_, count)| *count);
        }
        let messages = topics.iter().map(|topic| topic.messages).sum();
        Summary { file: self.path, seconds, bytes, messages, missed: missed.values().sum(), topics, error }.judged()
    }

    /// Messages that were missed so far, of the topics where there are any.
    fn missed(&self) -> BTreeMap<Topic, u64> {
        let count = |intake: &Intake| intake.dropped + intake.gaps.as_ref().map_or(0, Gaps::missed);
        let each = Topic::ALL.iter().zip(&self.intakes);
        each.filter_map(|(topic, intake)| Some((*topic, count(intake.as_ref()?)))).filter(|(_, n)| *n > 0).collect()
    }

    fn hand_over(&mut self) {
        self.handed_over = Instant::now();
        if self.batch.messages.is_empty() {
            return;
        }
        let batch = Batch { missed: self.missed(), ..std::mem::take(&mut self.batch) };
        let patience = if self.mode == Mode::Lockstep { LOCKSTEP_LIMIT } else { Duration::ZERO };
        if let Err(Order::Write(batch)) = self.send(Order::Write(batch), patience) {
            self.batch = batch;
            if self.mode == Mode::Lockstep {
                // The source has waited long enough.
                self.mode = Mode::FromTheFirst;
            }
        }
    }

    /// Gives the order back where there is no room for it for so long; an order to one who writes no more is done.
    fn send(&self, order: Order, patience: Duration) -> Result<(), Order> {
        let (mut order, since) = (order, Instant::now());
        loop {
            order = match self.queue.try_send(order) {
                Ok(()) | Err(TrySendError::Disconnected(_)) => return Ok(()),
                Err(TrySendError::Full(order)) if since.elapsed() >= patience => return Err(order),
                Err(TrySendError::Full(order)) => order,
            };
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Writes until it is told to finish, or whoever tells is gone, or the file can be written no more.
fn work(
    file: ChunkFile,
    heading: &Heading,
    topics: &[Topic],
    clocks: Clocks,
    orders: Receiver<Order>,
    path: &Path,
    failure: &OnceLock<String>,
) -> Ended {
    let failed = |error| {
        // The first failure is the one that is told.
        let _ = failure.set(ended(path, error).to_string());
    };
    let mut writer = match Writer::begin(file, heading, topics, clocks) {
        Ok(writer) => writer,
        Err(error) => {
            failed(error);
            return Ended { seconds: 0.0, bytes: 0, topics: Vec::new() };
        }
    };
    let finished = follow(&mut writer, &orders).map_err(failed).is_ok();
    let (mut file, seconds, topics) = writer.into_file();
    // The summary of what the file holds.
    if finished && let Err(cause) = std::io::Write::flush(&mut file).and_then(|()| file.sync()) {
        failed(cause.into());
    }
    Ended { seconds, bytes: file.bytes(), topics }
}

fn follow(writer: &mut Writer, orders: &Receiver<Order>) -> McapResult<()> {
    let (mut flushed, mut unflushed) = (Instant::now(), 0);
    let (mut told, mut missed) = (None::<Instant>, BTreeMap::new());
    loop {
        match orders.recv_timeout(FLUSH.saturating_sub(flushed.elapsed())) {
            Ok(Order::Write(batch)) => {
                let mut bytes = batch.bytes.as_slice();
                for (topic, len, taken_ns) in &batch.messages {
                    let (message, rest) = bytes.split_at((*len as usize).min(bytes.len()));
                    writer.write(*topic, message, *taken_ns)?;
                    bytes = rest;
                }
                unflushed += batch.bytes.len();
                if batch.missed != missed && told.is_none_or(|told| told.elapsed() >= TOLD) {
                    writer.missed(&batch.missed)?;
                    (told, missed) = (Some(Instant::now()), batch.missed);
                }
            }
            Ok(Order::Finish { how, report, missed: all }) => {
                if all != missed {
                    writer.missed(&all)?;
                }
                return writer.finish(&how, report.as_deref());
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writer.finish("the recorder was left", None),
        }
        if flushed.elapsed() >= FLUSH || unflushed >= FLUSH_BYTES {
            if unflushed > 0 {
                writer.flush()?;
            }
            (flushed, unflushed) = (Instant::now(), 0);
        }
    }
}

/// A name in the folder that nothing has yet: the system's with the time, UTC.
pub fn free_path(folder: &Path, system: &str) -> Result<PathBuf, FlightError> {
    let now = utc(clock_gettime(ClockId::Realtime).tv_sec, ["", "T", ""]);
    let name =
        |n: u32| folder.join(format!("{system}-{now}{}.mcap", if n > 1 { format!("-{n}") } else { String::new() }));
    let is_free = |path: &PathBuf| fs::symlink_metadata(path).is_err();
    (1..NAMES).map(name).find(is_free).ok_or_else(|| FlightError::Exists { path: name(NAMES) })
}

/// A second since 1970 with what stands between the parts of the date, between date and time, and between the parts of the time.
fn utc(unix_s: i64, [between, and, colon]: [&str; 3]) -> String {
    let at = OffsetDateTime::from_unix_timestamp(unix_s).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    let (year, month, day) = (at.year(), u8::from(at.month()), at.day());
    let (hour, minute, second) = (at.hour(), at.minute(), at.second());
    format!("{year:04}{between}{month:02}{between}{day:02}{and}{hour:02}{colon}{minute:02}{colon}{second:02}Z")
}

/// Every tick is expected on the topic.
fn has_every_tick(topic: Topic) -> bool {
    topic.entry().presence == Presence::EveryTick
}
