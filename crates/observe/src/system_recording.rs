//! Recording of a running system to a file.
//!
//! Input: messages of the system's bus, read by an observer. Output: a flight. Time:
//! [`SystemRecording::poll`] must be called every [`POLL_INTERVAL`]. Failure: messages that are
//! lost because the observer or the disk is too slow are counted as missed. The system never waits.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use bus::{BusError, Observer, SystemName};
use control::{ControlError, ControlRequest, send_request};
use flight::{FlightError, FlightHeader, Recorder, RecordingMode, RecordingSummary};
use graph::Topic;
use runtime::ServiceConfig;

use crate::late_topic::LateTopic;

/// Interval between two calls of [`SystemRecording::poll`]. An observer's buffer holds far more
/// messages than arrive in one interval.
pub const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Interval between checks that the system is running.
const LIVENESS_INTERVAL: Duration = Duration::from_millis(200);
/// Timeout for reattaching after the supervisor has renewed the system's bus.
const RENEWAL_TIMEOUT: Duration = Duration::from_secs(10);

/// Error when starting a recording.
#[derive(Debug, thiserror::Error)]
pub enum SystemRecordingError {
    /// The system cannot be observed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The file cannot be created.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// The system does not respond.
    #[error(transparent)]
    Control(#[from] ControlError),
}

/// Ongoing recording of a running system.
#[derive(Debug)]
pub struct SystemRecording {
    system: SystemName,
    topics: Vec<Topic>,
    recorder: Recorder,
    connection: Connection,
    checked_at: Instant,
}

#[derive(Debug)]
enum Connection {
    Open(TopicTaps),
    /// The bus of this supervisor was removed at this time and may be renewed.
    Lost {
        supervisor: u32,
        since: Instant,
    },
}

impl SystemRecording {
    /// Starts recording the topics of a system to a new file.
    ///
    /// # Errors
    ///
    /// Returns an error if the system is not running or does not respond, or if the file exists or
    /// cannot be created.
    pub fn start(
        system: &str,
        topics: &[Topic],
        path: &Path,
        version: &'static str,
    ) -> Result<Self, SystemRecordingError> {
        let system_name = SystemName::new(system)?;
        let observer = Observer::attach(&system_name, "record")?;
        let config = send_request::<ServiceConfig>(system, &ControlRequest::ServiceConfig)?;
        let taps = TopicTaps::attach(observer, topics)?;
        let header = FlightHeader::new(version, &config);
        let recorder = Recorder::create(path, &header, topics, RecordingMode::FromAnyTick)?;
        let connection = Connection::Open(taps);
        Ok(Self { system: system_name, topics: topics.to_vec(), recorder, connection, checked_at: Instant::now() })
    }

    /// Records the available messages. Returns the reason if the recording cannot continue.
    pub fn poll(&mut self) -> Option<&'static str> {
        match &mut self.connection {
            Connection::Open(taps) => taps.drain_into(&mut self.recorder),
            Connection::Lost { supervisor, since } => {
                let (supervisor, since) = (*supervisor, *since);
                if let Some(end) = self.reattach(supervisor, since) {
                    return Some(end);
                }
            }
        }
        if self.recorder.failure().is_some() {
            return Some("write error");
        }
        if let Connection::Open(taps) = &self.connection
            && self.checked_at.elapsed() >= LIVENESS_INTERVAL
        {
            self.checked_at = Instant::now();
            if !taps.observer.is_running() {
                // The old bus is released before the new one is opened.
                let supervisor = taps.observer.owner_pid();
                self.connection = Connection::Lost { supervisor, since: Instant::now() };
            }
        }
        None
    }

    /// Attaches to the renewed bus of the same system. Returns `None` once the observer is
    /// attached, or while the bus may still be renewed. Otherwise returns the reason why there is
    /// no bus.
    fn reattach(&mut self, supervisor: u32, since: Instant) -> Option<&'static str> {
        let is_alive = Path::new(&format!("/proc/{supervisor}")).exists();
        match Observer::attach(&self.system, "record") {
            Ok(observer) if observer.owner_pid() != supervisor => return Some("the system ended"),
            Ok(observer) => {
                if let Ok(taps) = TopicTaps::attach(observer, &self.topics) {
                    self.connection = Connection::Open(taps);
                    return None;
                }
            }
            Err(_) if !is_alive => return Some("the system ended"),
            Err(_) => {}
        }
        (since.elapsed() >= RENEWAL_TIMEOUT).then_some("the files of the system's bus were removed")
    }

    /// Records the messages that are still available and completes the file with the reason for its
    /// end. Errors are part of the summary.
    pub fn finish(mut self, end_reason: &str) -> RecordingSummary {
        if let Connection::Open(taps) = &mut self.connection {
            taps.drain_into(&mut self.recorder);
        }
        self.recorder.finish(end_reason, None)
    }
}

/// Topics of a running system. The taps must be dropped before the observer.
#[derive(Debug)]
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
