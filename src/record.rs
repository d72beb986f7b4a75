//! `plumb record`: records a running system to a file.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use bus::{BusError, Observer};
use clap::Args;
use control::{ControlError, ControlRequest, send_request};
use flight::{FlightError, FlightHeader, Recorder, RecordingMode, RecordingSummary};
use graph::Topic;
use mapping::names::UnknownName;
use runtime::ServiceConfig;

use crate::{
    duration::duration,
    failure::{fail, fail_after_result},
    stdout::print,
    system::LocalSystemArgs,
    topics::{LateTopic, ObserveError, POLL_INTERVAL, StopCondition, observer},
};

/// Timeout for reattaching after the supervisor has renewed the system's bus.
const RENEWAL_TIMEOUT: Duration = Duration::from_secs(10);

/// Arguments of `plumb record`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb record -o flight.mcap         # until Ctrl-C or the end of the system
  plumb record -o part.mcap --topics imu,attitude --for 10s
  plumb record -o alpha.mcap --system alpha --json

Exit codes: 0 complete, 1 messages missed or recording cut short, 2 wrong usage.")]
pub(crate) struct Record {
    #[command(flatten)]
    system: LocalSystemArgs,
    /// MCAP file to create; it must not exist
    #[arg(short, long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Topics separated by commas, see `plumb topic list` [default: all]
    #[arg(long, value_name = "TOPICS", value_delimiter = ',', value_parser = parse_topic)]
    topics: Vec<Topic>,
    /// Recording time, such as 500ms, 10s, 2m or 1h [default: until Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
}

/// Error while recording.
#[derive(Debug, thiserror::Error)]
enum RecordError {
    #[error(transparent)]
    Observe(#[from] ObserveError),
    #[error(transparent)]
    Flight(#[from] FlightError),
    #[error(transparent)]
    Control(#[from] ControlError),
}

impl From<BusError> for RecordError {
    fn from(error: BusError) -> Self {
        Self::Observe(error.into())
    }
}

impl RecordError {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Observe(error) => error.exit_code(),
            Self::Flight(FlightError::Exists { .. }) => 2,
            _ => 1,
        }
    }
}

pub(crate) fn run(record: &Record) -> ExitCode {
    let summary = match record_until_stopped(record) {
        Ok(summary) => summary,
        Err(error) => return fail(&error, error.exit_code()),
    };
    let printed = match record.system.json {
        // Serialising numbers, strings and lists cannot fail.
        true => print(&serde_json::to_string(&summary).unwrap_or_default()),
        false => print(&summary),
    };
    match &summary.error {
        Some(error) => fail_after_result(error, 1),
        None => printed,
    }
}

/// Records until the time limit is reached, a signal arrives or the system ends.
fn record_until_stopped(Record { system, out, topics, duration }: &Record) -> Result<RecordingSummary, RecordError> {
    let name = system.name();
    let topics = if topics.is_empty() { Topic::ALL } else { topics };
    let observer = observer(&name, "record")?;
    let config = send_request::<ServiceConfig>(&name, &ControlRequest::ServiceConfig)?;
    let header = FlightHeader::new(env!("CARGO_PKG_VERSION"), &config);
    let mut taps = TopicTaps::attach(observer, topics)?;
    let mut recorder = Recorder::create(out, &header, topics, RecordingMode::FromAnyTick)?;
    let mut stop = StopCondition::new(|| true, *duration);
    let mut checked_at = Instant::now();
    let end_reason = loop {
        if stop.is_met() {
            break "stopped on request";
        }
        taps.drain_into(&mut recorder);
        if recorder.failure().is_some() {
            break "write error";
        }
        if checked_at.elapsed() >= LIVENESS_INTERVAL {
            checked_at = Instant::now();
            if !taps.observer.is_running() {
                let supervisor = taps.observer.owner_pid();
                // The old bus must be released before the new one is opened.
                drop(taps);
                match reattach(&name, supervisor, topics, &mut stop) {
                    Some(found) => taps = found,
                    None if is_alive(supervisor) => {
                        return Ok(recorder.finish("the files of the system's bus were removed", None));
                    }
                    None => return Ok(recorder.finish("the system ended", None)),
                }
            }
        }
        thread::sleep(POLL_INTERVAL);
    };
    taps.drain_into(&mut recorder);
    Ok(recorder.finish(end_reason, None))
}

/// Interval between checks that the system is running.
const LIVENESS_INTERVAL: Duration = Duration::from_millis(200);

/// Topics of a running system. The taps must be dropped before the observer.
struct TopicTaps {
    taps: Vec<(Topic, LateTopic)>,
    observer: Observer,
}

impl TopicTaps {
    fn attach(observer: Observer, topics: &[Topic]) -> Result<Self, BusError> {
        let mut taps: Vec<_> = topics.iter().map(|topic| (*topic, LateTopic::new(*topic))).collect();
        taps.iter_mut().try_for_each(|(_, late)| late.tap(&observer).map(drop))?;
        Ok(Self { taps, observer })
    }

    fn drain_into(&mut self, recorder: &mut Recorder) {
        for (topic, late) in &mut self.taps {
            let Ok(Some(tap)) = late.tap(&self.observer) else { continue };
            let read = tap.drain(&mut |message| recorder.record(*topic, message));
            if read.unwrap_or(true) {
                recorder.record_overflow(*topic);
            }
        }
        recorder.poll();
    }
}

/// Attaches to the renewed bus of the same system. Returns `None` if the system has ended, on a
/// timeout or on a stop request.
fn reattach(name: &str, supervisor: u32, topics: &[Topic], stop: &mut StopCondition) -> Option<TopicTaps> {
    let started = Instant::now();
    while started.elapsed() < RENEWAL_TIMEOUT && !stop.is_met() {
        match observer(name, "record") {
            Ok(observer) if observer.owner_pid() != supervisor => return None,
            Ok(observer) => {
                if let Ok(taps) = TopicTaps::attach(observer, topics) {
                    return Some(taps);
                }
            }
            Err(_) if !is_alive(supervisor) => return None,
            Err(_) => {}
        }
        thread::sleep(POLL_INTERVAL);
    }
    None
}

fn is_alive(pid: u32) -> bool {
    Path::new(&format!("/proc/{pid}")).exists()
}

fn parse_topic(name: &str) -> Result<Topic, String> {
    let unknown = || UnknownName::new("topic", name, Topic::ALL.iter().map(|topic| topic.name()));
    Topic::from_name(name).ok_or_else(|| unknown().to_string())
}
