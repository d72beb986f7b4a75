//! Distribution of snapshots, status and calibration progress to the viewers.
//!
//! Input: messages for the page, and the calibration requests of viewers.
//! Output: for each viewer, the messages after its `Cursor`. A new viewer first receives the
//! status, the events so far and the snapshots of the last minute, then every later snapshot.
//! Time: a new viewer receives every snapshot for `CATCH_UP_TIME`.
//! Failure: a viewer that is too slow misses snapshots. Nothing waits for a viewer.

use std::{
    collections::VecDeque,
    sync::Mutex,
    time::{Duration, Instant},
};

use axum::body::Bytes;
use tokio::sync::watch::{self, Receiver};
use wire::{
    command::ControlMessage,
    v1::{
        AttitudeOutput, Calibration, Snapshot, SystemEvent, SystemStatus, ToPage, system_status::State,
        to_page::Content,
    },
};

use crate::{calibration::CalibrationRequest, decimator::MAX_EVENTS, locked::lock};

/// Maximum number of snapshots by which a viewer may be late. They span a quarter of a second. A
/// viewer that falls further behind continues with the newest snapshot.
const MAX_LATE_SNAPSHOTS: usize = 8;
/// Time for which a new viewer receives every snapshot, however late it is. A new viewer needs this
/// time, because the snapshots of the last minute take about 2 MB and a page is busy while it
/// loads.
const CATCH_UP_TIME: Duration = Duration::from_secs(10);

/// Time for which snapshots are kept for new viewers. It equals the time span of the strip charts
/// on the page.
const HISTORY: Duration = Duration::from_secs(60);
/// Maximum total size of the kept snapshots, in bytes. An ordinary minute of snapshots takes at
/// most half of it.
const MAX_HISTORY_BYTES: usize = 8 << 20;

/// Messages for the viewers.
#[derive(Debug, Default)]
pub struct Hub {
    /// Notifies the viewers of new messages.
    news: watch::Sender<()>,
    backlog: Mutex<Backlog>,
    /// Request that is not processed yet: `Some(Some(…))` starts a calibration, `Some(None)`
    /// cancels the one in progress.
    calibration_request: Mutex<Option<Option<CalibrationRequest>>>,
    #[cfg(feature = "foxglove")]
    pub(crate) broadcaster: std::sync::Arc<crate::foxglove::feed::Broadcaster>,
}

/// Messages that some viewers have not received yet, and the newest values for `/metrics`.
#[derive(Debug, Default)]
struct Backlog {
    latest: LatestState,
    /// Sequence number of the newest status.
    status_number: u64,
    calibration: Option<Calibration>,
    /// Launch-file sections with the result of `calibration`; `None` without a result.
    sections: Option<String>,
    /// Sequence number of the newest progress report of a calibration.
    calibration_number: u64,
    events: VecDeque<SystemEvent>,
    history: History,
}

/// Encoded snapshots of the last minute, oldest first.
#[derive(Debug, Default)]
struct History {
    snapshots: VecDeque<EncodedSnapshot>,
    bytes: usize,
    /// Sequence number of the next snapshot.
    next: u64,
}

#[derive(Debug)]
struct EncodedSnapshot {
    number: u64,
    /// Time of the snapshot on CLOCK_MONOTONIC, ns.
    t_ns: u64,
    flags: u64,
    has_data: bool,
    has_events: bool,
    message: Bytes,
}

/// Position of a viewer in the messages of a hub.
#[derive(Debug)]
pub(crate) struct Cursor {
    /// Sequence number of the last status received.
    status: Option<u64>,
    has_earlier_events: bool,
    /// Sequence number of the last calibration report received.
    calibration: u64,
    /// Sequence number of the next snapshot.
    snapshot: u64,
    /// Time until which the viewer receives every snapshot.
    catches_up_until: Instant,
}

impl EncodedSnapshot {
    /// Encodes a snapshot that has no number yet.
    fn encode(snapshot: Snapshot) -> Self {
        Self {
            number: 0,
            t_ns: snapshot.t_created_ns,
            flags: snapshot.flags,
            has_data: snapshot.attitude.is_some() || snapshot.imu.is_some(),
            has_events: !snapshot.events.is_empty(),
            message: encode(Content::Snapshot(snapshot)),
        }
    }
}

impl History {
    fn push(&mut self, snapshot: EncodedSnapshot) {
        let EncodedSnapshot { t_ns, has_data, .. } = snapshot;
        self.bytes += snapshot.message.len();
        self.snapshots.push_back(EncodedSnapshot { number: self.next, ..snapshot });
        self.next += 1;
        // A snapshot without content is kept only for viewers that are up to date.
        if let Some(at) = self.snapshots.len().checked_sub(MAX_LATE_SNAPSHOTS + 1)
            && let EncodedSnapshot { has_data: false, has_events: false, message, .. } = &self.snapshots[at]
        {
            self.bytes -= message.len();
            self.snapshots.remove(at);
        }
        // While no new data arrive, the last minute of snapshots with data is kept.
        let from_ns = if has_data { t_ns.saturating_sub(HISTORY.as_nanos() as u64) } else { 0 };
        while let Some(first) = self.snapshots.front()
            && (first.t_ns < from_ns || self.bytes > MAX_HISTORY_BYTES)
        {
            self.bytes -= first.message.len();
            self.snapshots.pop_front();
        }
    }

    /// Returns the snapshots from `number` on.
    fn since(&self, number: u64) -> impl Iterator<Item = &EncodedSnapshot> {
        self.snapshots.range(self.snapshots.partition_point(|snapshot| snapshot.number < number)..)
    }
}

/// Newest values, for `/metrics`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LatestState {
    pub(crate) status: SystemStatus,
    /// Newest attitude of the running system; `None` unless the system is live.
    pub(crate) attitude: Option<AttitudeOutput>,
    /// Estimated gyro bias in body axes, rad/s.
    pub(crate) bias_rad_s: Option<[f64; 3]>,
}

impl Hub {
    /// Sends a snapshot to the viewers.
    pub fn publish_snapshot(&self, snapshot: Snapshot) {
        let mut backlog = lock(&self.backlog);
        backlog.events.extend(snapshot.events.iter().cloned());
        let excess = backlog.events.len().saturating_sub(MAX_EVENTS);
        backlog.events.drain(..excess);
        if snapshot.attitude.is_some() {
            backlog.latest.attitude = snapshot.attitude;
        }
        if let Some(bias) = snapshot.fused.as_ref().and_then(|fused| fused.bias_rad_s.as_ref()) {
            backlog.latest.bias_rad_s = Some([bias.x, bias.y, bias.z]);
        }
        backlog.history.push(EncodedSnapshot::encode(snapshot));
        drop(backlog);
        self.news.send_replace(());
    }

    /// Sends the system's status to the viewers. Also clears the latest values unless the system is
    /// live.
    pub fn publish_status(&self, status: SystemStatus) {
        let mut backlog = lock(&self.backlog);
        if status.state() != State::Live {
            backlog.latest = LatestState::default();
        }
        backlog.latest.status = status;
        backlog.status_number += 1;
        drop(backlog);
        self.news.send_replace(());
    }

    /// Sends the progress of a calibration to the viewers, and keeps the launch-file sections with
    /// its result.
    pub(crate) fn publish_calibration(&self, calibration: Calibration, sections: Option<String>) {
        let mut backlog = lock(&self.backlog);
        backlog.sections = sections;
        backlog.calibration = Some(calibration).filter(|calibration| !calibration.what.is_empty());
        backlog.calibration_number += 1;
        drop(backlog);
        self.news.send_replace(());
    }

    /// Returns the launch-file sections with the result of the calibration `what`; `None` if its
    /// result is not the newest one.
    pub(crate) fn calibration_sections(&self, what: &str) -> Option<String> {
        let backlog = lock(&self.backlog);
        backlog.sections.clone().filter(|_| backlog.calibration.as_ref().is_some_and(|newest| newest.what == what))
    }

    /// Requests the start of a calibration or, with `None`, the end of the one in progress.
    pub(crate) fn request_calibration(&self, request: Option<CalibrationRequest>) {
        *lock(&self.calibration_request) = Some(request);
    }

    /// Removes and returns the request made since the last call.
    pub(crate) fn take_calibration_request(&self) -> Option<Option<CalibrationRequest>> {
        lock(&self.calibration_request).take()
    }

    /// Returns `true` if a viewer or a Foxglove client is connected.
    pub fn has_viewers(&self) -> bool {
        #[cfg(feature = "foxglove")]
        let has_foxglove_clients = self.broadcaster.has_clients();
        #[cfg(not(feature = "foxglove"))]
        let has_foxglove_clients = false;
        self.news.receiver_count() > 0 || has_foxglove_clients
    }

    /// Returns the position of a new viewer, and a receiver that is notified of new messages.
    pub(crate) fn subscribe(&self) -> (Cursor, Receiver<()>) {
        let catches_up_until = Instant::now() + CATCH_UP_TIME;
        let cursor = Cursor { status: None, has_earlier_events: false, calibration: 0, snapshot: 0, catches_up_until };
        (cursor, self.news.subscribe())
    }

    /// Returns the next message for a viewer; `None` if it has received all messages.
    ///
    /// A viewer receives only the newest status and the newest calibration. A viewer that is more
    /// than [`MAX_LATE_SNAPSHOTS`] snapshots late after [`CATCH_UP_TIME`] receives a summary
    /// instead of the missed snapshots. The summary has all events and flags of the missed
    /// snapshots, because events and flags are never decimated.
    pub(crate) fn next_message(&self, cursor: &mut Cursor) -> Option<Bytes> {
        let backlog = lock(&self.backlog);
        if cursor.status != Some(backlog.status_number) {
            cursor.status = Some(backlog.status_number);
            return Some(encode(Content::SystemStatus(backlog.latest.status.clone())));
        }
        if !std::mem::replace(&mut cursor.has_earlier_events, true) {
            return Some(encode(Content::Snapshot(backlog.summary(u64::MAX))));
        }
        if cursor.calibration != backlog.calibration_number {
            cursor.calibration = backlog.calibration_number;
            return Some(encode(Content::Calibration(backlog.calibration.clone().unwrap_or_default())));
        }
        let late = backlog.history.next.saturating_sub(cursor.snapshot);
        if late > MAX_LATE_SNAPSHOTS as u64 && Instant::now() >= cursor.catches_up_until {
            let from = std::mem::replace(&mut cursor.snapshot, backlog.history.next - 1);
            return Some(encode(Content::Snapshot(backlog.summary(from))));
        }
        let snapshot = backlog.history.since(cursor.snapshot).next()?;
        cursor.snapshot = snapshot.number + 1;
        Some(snapshot.message.clone())
    }

    /// Returns the newest values for `/metrics`.
    pub(crate) fn latest(&self) -> LatestState {
        lock(&self.backlog).latest.clone()
    }
}

impl Backlog {
    /// Returns a snapshot of all events and the combined flags of the snapshots from `number` on.
    fn summary(&self, number: u64) -> Snapshot {
        let flags = self.history.since(number).fold(0, |all, snapshot| all | snapshot.flags);
        Snapshot { events: self.events.iter().cloned().collect(), flags, ..Snapshot::default() }
    }
}

pub(crate) fn encode(message: Content) -> Bytes {
    ToPage { content: Some(message) }.to_bytes().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the snapshots that a viewer receives until it has received all messages.
    fn receive(hub: &Hub, cursor: &mut Cursor) -> Vec<Snapshot> {
        std::iter::from_fn(|| hub.next_message(cursor)).filter_map(|message| snapshot(&message)).collect()
    }

    /// Returns the position of a viewer that subscribed more than [`CATCH_UP_TIME`] ago.
    fn earlier_viewer(hub: &Hub) -> Cursor {
        Cursor { catches_up_until: Instant::now(), ..hub.subscribe().0 }
    }

    fn snapshot(message: &[u8]) -> Option<Snapshot> {
        match ToPage::from_bytes(message).unwrap().content {
            Some(Content::Snapshot(snapshot)) => Some(snapshot),
            _ => None,
        }
    }

    fn with_data(number: u64) -> Snapshot {
        let attitude = Some(AttitudeOutput::default());
        Snapshot { number, t_created_ns: number * 33_000_000, attitude, ..Snapshot::default() }
    }

    #[test]
    fn new_viewer_receives_snapshots_of_last_minute() {
        let hub = Hub::default();
        for number in 0..3000 {
            let attitude = with_data(number).attitude.filter(|_| number % 2 == 0);
            hub.publish_snapshot(Snapshot { attitude, ..with_data(number) });
        }
        let (mut cursor, _) = hub.subscribe();
        let numbers: Vec<_> = receive(&hub, &mut cursor).iter().skip(1).map(|snapshot| snapshot.number).collect();
        // The last 60 s contain 1818 snapshots. Every second one has data and is kept, and so are
        // the newest eight.
        let expected: Vec<_> = (1180..3000).filter(|number| number % 2 == 0 || *number >= 2992).collect();
        assert_eq!(numbers, expected);
        let mut history = History::default();
        let large =
            |number| EncodedSnapshot { message: vec![0; 1 << 16].into(), ..EncodedSnapshot::encode(with_data(number)) };
        (0..1000).for_each(|number| history.push(large(number)));
        assert_eq!((history.bytes, history.snapshots.len()), (MAX_HISTORY_BYTES, MAX_HISTORY_BYTES >> 16));
    }

    #[test]
    fn history_continues_without_gap_in_live_snapshots() {
        let hub = Hub::default();
        (0..500).for_each(|number| hub.publish_snapshot(with_data(number)));
        let (mut cursor, _) = hub.subscribe();
        // While the history is sent, more new snapshots arrive than `MAX_LATE_SNAPSHOTS`.
        let (mut received, mut next) = (Vec::new(), 500);
        while let Some(message) = hub.next_message(&mut cursor) {
            received.extend(snapshot(&message));
            if received.len() % 2 == 0 {
                hub.publish_snapshot(with_data(next));
                next += 1;
            }
        }
        // A page that is loading may be too busy to receive the next snapshots in time.
        (next..next + 100).for_each(|number| hub.publish_snapshot(with_data(number)));
        (received, next) = (received.into_iter().chain(receive(&hub, &mut cursor)).collect(), next + 100);
        let numbers: Vec<_> = received.iter().skip(1).map(|snapshot| snapshot.number).collect();
        assert!(next > 1000, "{next}");
        assert_eq!(numbers, (0..next).collect::<Vec<_>>());
    }

    #[test]
    fn slow_viewer_continues_with_newest_snapshot() {
        let hub = Hub::default();
        let mut cursor = earlier_viewer(&hub);
        assert_eq!(receive(&hub, &mut cursor).len(), 1, "the summary of the events");
        (0..1000).for_each(|number| hub.publish_snapshot(with_data(number)));
        let numbers: Vec<_> = receive(&hub, &mut cursor).iter().skip(1).map(|snapshot| snapshot.number).collect();
        assert_eq!(numbers, [999]);
        (1000..1008).for_each(|number| hub.publish_snapshot(with_data(number)));
        assert_eq!(receive(&hub, &mut cursor).len(), MAX_LATE_SNAPSHOTS, "a short delay loses nothing");
    }

    #[test]
    fn summary_includes_events_and_flags_of_missed_snapshots() {
        let hub = Hub::default();
        let mut cursor = earlier_viewer(&hub);
        hub.publish_snapshot(Snapshot { flags: 0b1000, ..with_data(0) });
        receive(&hub, &mut cursor);
        let events = vec![SystemEvent { number: 7, ..SystemEvent::default() }];
        hub.publish_snapshot(Snapshot { events, flags: 0b100, ..with_data(1) });
        (2..20).for_each(|number| hub.publish_snapshot(Snapshot { flags: 0b1, ..with_data(number) }));
        let summary = receive(&hub, &mut cursor).remove(0);
        assert_eq!(summary.events.iter().map(|event| event.number).collect::<Vec<_>>(), [7]);
        assert_eq!(summary.flags, 0b101, "flags of received snapshots are not repeated");
    }

    #[test]
    fn new_viewer_receives_earlier_events() {
        let hub = Hub::default();
        for number in 0..(MAX_EVENTS as u64 + 10) {
            let events = vec![SystemEvent { number, ..SystemEvent::default() }];
            hub.publish_snapshot(Snapshot { events, ..Snapshot::default() });
        }
        let (mut cursor, _) = hub.subscribe();
        let past = receive(&hub, &mut cursor).remove(0);
        assert_eq!((past.events.len(), past.events[0].number), (MAX_EVENTS, 10));
    }

    #[test]
    fn result_of_calibration_reaches_slow_viewer() {
        let hub = Hub::default();
        let (mut cursor, _) = hub.subscribe();
        receive(&hub, &mut cursor);
        for report in ["", "bias"] {
            let sections = Some(report.to_owned()).filter(|report| !report.is_empty());
            let progress = Calibration { what: "gyro".into(), report: report.into(), ..Calibration::default() };
            hub.publish_calibration(progress, sections);
        }
        assert_eq!(hub.calibration_sections("gyro").as_deref(), Some("bias"));
        assert_eq!(hub.calibration_sections("accel"), None, "the result is another one");
        (0..1000).for_each(|number| hub.publish_snapshot(with_data(number)));
        let received: Vec<_> = std::iter::from_fn(|| hub.next_message(&mut cursor)).collect();
        let reports = received.iter().filter_map(|message| match ToPage::from_bytes(message).unwrap().content {
            Some(Content::Calibration(calibration)) => Some(calibration.report),
            _ => None,
        });
        assert_eq!(reports.collect::<Vec<_>>(), ["bias"]);
    }
}
