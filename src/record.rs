//! `plumb record`: a running system into a file; and the same from the first tick on, for `plumb up --record`.

use std::{
    fs,
    os::unix::fs::DirBuilderExt,
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use bus::{BusError, Observer, Tap};
use clap::Args;
use control::{ControlError, ControlRequest, send_request};
use flight::{FlightError, Heading, Mode, Recorder, Summary};
use graph::{Service, Topic};
use runtime::ServiceConfig;
use supervisor::{RecordingReport, Report, UpError};

use crate::{
    fail, fail_after_result,
    out::print,
    seeing::{LOOK, SeeError, Until, observer},
    system::OnBoard,
    up::duration_s,
};

/// How long a system whose bus was made anew is looked for.
const RENEWAL_LIMIT: Duration = Duration::from_secs(10);

/// The command line of `plumb record`.
#[derive(Args)]
#[command(
    after_help = "Exit codes: 0 the file is whole, 1 messages were missed or the file ended before its time, 2 wrong usage."
)]
pub(crate) struct Record {
    #[command(flatten)]
    system: OnBoard,
    /// The file to write; there must be none of that name.
    #[arg(short, long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// The topics, with commas between them, as `plumb topic list` names them [default: every one].
    #[arg(long, value_name = "TOPICS", value_delimiter = ',', value_parser = topic)]
    topics: Vec<Topic>,
    /// How long, as `10s`, `500ms`, `2m`, `1h` [default: Ctrl-C ends it].
    #[arg(long = "for", value_name = "TIME", value_parser = duration_s)]
    duration_s: Option<f64>,
}

/// Why a running system is not recorded.
#[derive(Debug, thiserror::Error)]
enum RecordError {
    #[error(transparent)]
    See(#[from] SeeError),
    #[error(transparent)]
    Flight(#[from] FlightError),
    #[error(transparent)]
    Control(#[from] ControlError),
}

impl From<BusError> for RecordError {
    fn from(error: BusError) -> Self {
        Self::See(error.into())
    }
}

impl RecordError {
    fn exit_code(&self) -> u8 {
        match self {
            Self::See(error) => error.exit_code(),
            Self::Flight(FlightError::Exists { .. }) => 2,
            _ => 1,
        }
    }
}

pub(crate) fn run(record: &Record) -> ExitCode {
    let summary = match follow(record) {
        Ok(summary) => summary,
        Err(error) => return fail(&error, error.exit_code()),
    };
    let printed = match record.system.json {
        // Numbers, strings and lists always serialise.
        true => print(&serde_json::to_string(&summary).unwrap_or_default()),
        false => print(&summary),
    };
    match &summary.error {
        Some(error) => fail_after_result(error, 1),
        None => printed,
    }
}

/// Records until the time is over, by Ctrl-C, or to the end of the system.
fn follow(Record { system, out, topics, duration_s }: &Record) -> Result<Summary, RecordError> {
    let name = system.name();
    let topics = if topics.is_empty() { Topic::ALL } else { topics };
    let seat = observer(&name, "record")?;
    let config = send_request::<ServiceConfig>(&name, &ControlRequest::ServiceConfig)?;
    let heading = Heading::new(env!("CARGO_PKG_VERSION"), &config);
    let mut place = Place::take(seat, topics)?;
    let mut recorder = Recorder::begin(out, &heading, topics, Mode::Live)?;
    let mut until = Until::new(|| true, duration_s.map(Duration::from_secs_f64));
    let mut looked = Instant::now();
    let how = loop {
        if until.is_over() {
            break "it was asked to";
        }
        place.look(&mut recorder);
        if recorder.failure().is_some() {
            break "nothing more could be written";
        }
        if looked.elapsed() >= RUNS_INTERVAL {
            looked = Instant::now();
            if !place.observer.is_running() {
                let supervisor = place.observer.owner_pid();
                // What is on the old bus is given back before the new one is looked at.
                drop(place);
                match again(&name, supervisor, topics, &mut until) {
                    Some(found) => place = found,
                    None if lives(supervisor) => {
                        return Ok(recorder.end("somebody removed the files of the system's bus", None));
                    }
                    None => return Ok(recorder.end("the system has ended", None)),
                }
            }
        }
        thread::sleep(LOOK);
    };
    place.look(&mut recorder);
    Ok(recorder.end(how, None))
}

/// Between two looks whether the system still runs.
const RUNS_INTERVAL: Duration = Duration::from_millis(200);

/// A place at the topics of a running system. The taps go before the seat.
struct Place {
    taps: Vec<(Topic, Tap)>,
    observer: Observer,
    topics: Vec<Topic>,
    looked: Instant,
}

impl Place {
    fn take(observer: Observer, topics: &[Topic]) -> Result<Self, BusError> {
        let mut place = Self { taps: Vec::new(), observer, topics: topics.to_vec(), looked: Instant::now() };
        place.open()?;
        Ok(place)
    }

    /// Opens the topics that are there and were not.
    fn open(&mut self) -> Result<(), BusError> {
        self.looked = Instant::now();
        for topic in &self.topics {
            if self.taps.iter().any(|(open, _)| open == topic) {
                continue;
            }
            match self.observer.tap(*topic) {
                Ok(tap) => self.taps.push((*topic, tap)),
                Err(BusError::TopicNotOpen { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn look(&mut self, recorder: &mut Recorder) {
        // A topic may come later than the others, as that of a driver does; where it cannot be opened now it is tried again.
        if self.looked.elapsed() >= RUNS_INTERVAL {
            let _ = self.open();
        }
        for (topic, tap) in &self.taps {
            let read = tap.drain(&mut |message| recorder.take(*topic, message));
            if read.unwrap_or(true) {
                recorder.overflowed(*topic);
            }
        }
        recorder.look();
    }
}

/// A place in the same system, where its bus was made anew; `None` where the system has ended.
fn again(name: &str, supervisor: u32, topics: &[Topic], until: &mut Until) -> Option<Place> {
    let since = Instant::now();
    while since.elapsed() < RENEWAL_LIMIT && !until.is_over() {
        match observer(name, "record") {
            Ok(seat) if seat.owner_pid() != supervisor => return None,
            Ok(seat) => {
                if let Ok(place) = Place::take(seat, topics) {
                    return Some(place);
                }
            }
            Err(_) if !lives(supervisor) => return None,
            Err(_) => {}
        }
        thread::sleep(LOOK);
    }
    None
}

fn lives(pid: u32) -> bool {
    Path::new(&format!("/proc/{pid}")).exists()
}

/// `plumb up --record`: the recorder of a system from its first tick on.
pub(crate) struct FlightRecorder {
    folder: PathBuf,
    launch_file: Option<PathBuf>,
    /// The source in one line that takes the place of the launch file's.
    source: Option<String>,
    /// Likewise the receiver.
    receiver: Option<String>,
    recorder: Option<Recorder>,
}

impl FlightRecorder {
    /// Each start makes one file in `folder`.
    pub(crate) fn new(folder: &Path, launch_file: Option<&Path>, source: Option<&str>, receiver: Option<&str>) -> Self {
        let (launch_file, source) = (launch_file.map(Path::to_owned), source.map(str::to_owned));
        Self { folder: folder.to_owned(), launch_file, source, receiver: receiver.map(str::to_owned), recorder: None }
    }
}

impl supervisor::Recorder for FlightRecorder {
    fn start(&mut self, config: &ServiceConfig) -> Result<(), UpError> {
        let refused = |error: FlightError| UpError::Recorder(error.to_string());
        let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(&self.folder);
        made.map_err(|cause| refused(FlightError::Create { path: self.folder.clone(), cause }))?;
        let path = flight::free_path(&self.folder, &config.launch.name).map_err(refused)?;
        let mode = match config.launch.tick_source() {
            Service::Ingest if config.is_lockstep() => Mode::Lockstep,
            Service::Ingest => Mode::FromTheFirst,
            // Ticks come from another host, and do not begin here.
            _ => Mode::Live,
        };
        let heading = Heading {
            launch_file: self.launch_file.clone(),
            launch: supervisor::plan::launch_text(self.launch_file.as_deref()).ok().and_then(|text| {
                match (self.source.as_deref(), self.receiver.as_deref()) {
                    (None, None) => Some(text),
                    (source, receiver) => launch::with_overrides(&text, source, receiver),
                }
            }),
            ..Heading::new(env!("CARGO_PKG_VERSION"), config)
        };
        self.recorder = Some(Recorder::begin(&path, &heading, Topic::ALL, mode).map_err(refused)?);
        supervisor::announce(format_args!("recording to {}", path.display()));
        Ok(())
    }

    fn record(&mut self, topic: Topic, message: &[u8]) {
        self.recorder.iter_mut().for_each(|recorder| recorder.take(topic, message));
    }

    fn on_overflow(&mut self, topic: Topic) {
        self.recorder.iter_mut().for_each(|recorder| recorder.overflowed(topic));
    }

    fn end_round(&mut self) {
        self.recorder.iter_mut().for_each(Recorder::look);
    }

    fn failure(&self) -> Option<String> {
        self.recorder.as_ref()?.failure().map(str::to_owned)
    }

    fn finish(&mut self, report: &Report) -> RecordingReport {
        let Some(recorder) = self.recorder.take() else { return RecordingReport::default() };
        let how = report.error.as_deref().unwrap_or("the system came to its end");
        let Summary { file, messages, missed, bytes, error, .. } = recorder.end(how, Some(report.to_json()));
        RecordingReport { file, messages, missed, bytes, error }
    }
}

fn topic(name: &str) -> Result<Topic, String> {
    let names = || Topic::ALL.iter().map(|topic| topic.name()).collect::<Vec<_>>().join(", ");
    Topic::from_name(name).ok_or_else(|| format!("there is none of that name; there are {}", names()))
}
