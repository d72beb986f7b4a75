//! Distribution of snapshots, status and calibration progress to the viewers.
//!
//! Input: messages for the page, and the calibration requests of viewers.
//! Output: a bounded message queue per viewer. A new viewer first receives the status, the events
//! so far and the snapshots of the last minute.
//! Failure: a viewer that is too slow loses messages. Nothing waits for a viewer.

use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use axum::body::Bytes;
use tokio::sync::broadcast::{self, Receiver};
use wire::{
    command::ControlMessage,
    v1::{AttitudeOutput, Calibration, Picture, Standing, SystemEvent, ToPage, standing::State, to_page::Said},
};

use crate::{calibration::CalibrationRequest, decimator::MAX_EVENTS};

/// Number of snapshots for which flags are kept, for viewers that missed these snapshots. The
/// number covers two seconds.
const MAX_STORED_FLAGS: usize = 64;
/// Maximum number of messages queued per viewer, enough for a quarter of a second. A viewer that
/// falls further behind loses the oldest messages.
const MAX_QUEUED_MESSAGES: usize = 8;

/// Time for which snapshots are kept for new viewers. It is the time span of the page's strips.
const HISTORY: Duration = Duration::from_secs(60);
/// Maximum size of the snapshots that are kept, bytes: twice that of an ordinary minute.
const MAX_HISTORY_BYTES: usize = 8 << 20;

/// Message queues of the viewers.
#[derive(Debug)]
pub struct Hub {
    messages: broadcast::Sender<Bytes>,
    backlog: Mutex<Backlog>,
    /// Request that is not processed yet: `Some(Some(…))` starts a calibration, `Some(None)`
    /// cancels the one in progress.
    calibration_request: Mutex<Option<Option<CalibrationRequest>>>,
    #[cfg(feature = "foxglove")]
    pub(crate) broadcaster: std::sync::Arc<crate::foxglove::feed::Broadcaster>,
}

/// Data for new viewers, for viewers that missed messages, and for `/metrics`.
#[derive(Debug, Default)]
struct Backlog {
    latest: LatestState,
    events: VecDeque<SystemEvent>,
    /// Flags of the newest snapshots, oldest first.
    flags: VecDeque<u64>,
    calibration: Option<Calibration>,
    history: History,
}

/// Encoded snapshots of the last minute, oldest first.
#[derive(Debug, Default)]
struct History {
    /// Time of each snapshot on CLOCK_MONOTONIC, ns, and the snapshot.
    snapshots: VecDeque<(u64, Bytes)>,
    bytes: usize,
}

impl History {
    fn push(&mut self, t_ns: u64, snapshot: Bytes) {
        self.bytes += snapshot.len();
        self.snapshots.push_back((t_ns, snapshot));
        let from_ns = t_ns.saturating_sub(HISTORY.as_nanos() as u64);
        while let Some((first_ns, first)) = self.snapshots.front()
            && (*first_ns < from_ns || self.bytes > MAX_HISTORY_BYTES)
        {
            self.bytes -= first.len();
            self.snapshots.pop_front();
        }
    }
}

/// Newest values, for `/metrics`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LatestState {
    pub(crate) standing: Standing,
    /// Newest attitude of the running system; `None` unless the system is live.
    pub(crate) attitude: Option<AttitudeOutput>,
    /// Estimated gyro bias in body axes, rad/s.
    pub(crate) bias_rad_s: Option<[f64; 3]>,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            messages: broadcast::Sender::new(MAX_QUEUED_MESSAGES),
            backlog: Mutex::default(),
            calibration_request: Mutex::default(),
            #[cfg(feature = "foxglove")]
            broadcaster: std::sync::Arc::default(),
        }
    }
}

impl Hub {
    /// Sends a snapshot to the viewers.
    pub fn publish_snapshot(&self, picture: Picture) {
        let mut backlog = self.backlog();
        backlog.events.extend(picture.events.iter().cloned());
        let excess = backlog.events.len().saturating_sub(MAX_EVENTS);
        backlog.events.drain(..excess);
        if backlog.flags.len() == MAX_STORED_FLAGS {
            backlog.flags.pop_front();
        }
        backlog.flags.push_back(picture.flags);
        if picture.attitude.is_some() {
            backlog.latest.attitude = picture.attitude;
        }
        if let Some(bias) = picture.fused.as_ref().and_then(|fused| fused.bias_rad_s.as_ref()) {
            backlog.latest.bias_rad_s = Some([bias.x, bias.y, bias.z]);
        }
        let (has_data, t_ns) = (picture.attitude.is_some() || picture.imu.is_some(), picture.t_made_ns);
        let message = encode(Said::Picture(picture));
        if has_data {
            backlog.history.push(t_ns, message.clone());
        }
        drop(backlog);
        // Sending fails only if there are no viewers.
        let _ = self.messages.send(message);
    }

    /// Sends the system's status to the viewers. Also clears the latest values unless the system is
    /// live.
    pub fn publish_status(&self, standing: Standing) {
        let mut backlog = self.backlog();
        if standing.state() != State::Live {
            backlog.latest = LatestState::default();
        }
        backlog.latest.standing = standing.clone();
        drop(backlog);
        self.send(Said::Standing(standing));
    }

    /// Sends the progress of a calibration to the viewers.
    pub(crate) fn publish_calibration(&self, calibration: Calibration) {
        self.backlog().calibration = Some(calibration.clone()).filter(|calibration| !calibration.what.is_empty());
        self.send(Said::Calibration(calibration));
    }

    /// Requests the start of a calibration or, with `None`, the end of the one in progress.
    pub(crate) fn request_calibration(&self, request: Option<CalibrationRequest>) {
        *self.calibration_request.lock().unwrap_or_else(PoisonError::into_inner) = Some(request);
    }

    /// Removes and returns the request made since the last call.
    pub(crate) fn take_calibration_request(&self) -> Option<Option<CalibrationRequest>> {
        self.calibration_request.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Returns `true` if a viewer or a Foxglove client is connected.
    pub fn has_viewers(&self) -> bool {
        #[cfg(feature = "foxglove")]
        let has_foxglove_clients = self.broadcaster.has_clients();
        #[cfg(not(feature = "foxglove"))]
        let has_foxglove_clients = false;
        self.messages.receiver_count() > 0 || has_foxglove_clients
    }

    /// Returns the initial messages for a new viewer and a queue for the messages that follow.
    pub(crate) fn subscribe(&self) -> (Vec<Bytes>, Receiver<Bytes>) {
        let messages = self.messages.subscribe();
        let backlog = self.backlog();
        let first = [Said::Standing(backlog.latest.standing.clone()), Said::Picture(backlog.summary(0))];
        let calibration = backlog.calibration.clone().map(Said::Calibration);
        let history = backlog.history.snapshots.iter().map(|(_, snapshot)| snapshot.clone());
        (first.into_iter().chain(calibration).map(encode).chain(history).collect(), messages)
    }

    /// Returns a summary to replace the `messages` messages that a viewer has missed.
    ///
    /// It contains all events and the flags of the missed snapshots, because events and flags are
    /// never decimated. It also contains the calibration, because its result is sent only once.
    pub(crate) fn catch_up(&self, messages: u64) -> [Bytes; 2] {
        let backlog = self.backlog();
        // The summary covers more snapshots than were missed, because further messages may be
        // dropped from the queue before the viewer receives the summary.
        let picture = backlog.summary(messages as usize + MAX_QUEUED_MESSAGES);
        [Said::Picture(picture), Said::Calibration(backlog.calibration.clone().unwrap_or_default())].map(encode)
    }

    /// Returns the newest values.
    pub(crate) fn latest(&self) -> LatestState {
        self.backlog().latest.clone()
    }

    fn send(&self, message: Said) {
        // Sending fails only if there are no viewers.
        let _ = self.messages.send(encode(message));
    }

    fn backlog(&self) -> MutexGuard<'_, Backlog> {
        self.backlog.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backlog {
    /// Returns a snapshot of all events and the combined flags of the newest `pictures` snapshots.
    fn summary(&self, pictures: usize) -> Picture {
        let flags = self.flags.iter().rev().take(pictures).fold(0, |all, flags| all | flags);
        Picture { events: self.events.iter().cloned().collect(), flags, ..Picture::default() }
    }
}

pub(crate) fn encode(message: Said) -> Bytes {
    ToPage { said: Some(message) }.to_bytes().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::broadcast::error::TryRecvError;

    #[test]
    fn new_viewer_receives_snapshots_of_last_minute() {
        let hub = Hub::default();
        for number in 0..3000 {
            let attitude = (number % 2 == 0).then(AttitudeOutput::default);
            let t_made_ns = number * 33_000_000;
            hub.publish_snapshot(Picture { number, t_made_ns, attitude, ..Picture::default() });
        }
        let (first, _) = hub.subscribe();
        let numbers: Vec<u64> = first[2..]
            .iter()
            .map(|message| match ToPage::from_bytes(message).unwrap().said {
                Some(Said::Picture(picture)) => picture.number,
                other => panic!("{other:?}"),
            })
            .collect();
        // 60 s are 1818 snapshots, half of which have data. The last number with data is 2998.
        assert_eq!(numbers, (1180..3000).step_by(2).collect::<Vec<_>>());
        let mut history = History::default();
        (0..1000).for_each(|t_ns| history.push(t_ns, vec![0; 1 << 16].into()));
        assert_eq!((history.bytes, history.snapshots.len()), (MAX_HISTORY_BYTES, MAX_HISTORY_BYTES >> 16));
    }

    #[test]
    fn slow_viewer_misses_snapshots_without_blocking() {
        let hub = Hub::default();
        let (first, mut messages) = hub.subscribe();
        assert_eq!(first.len(), 2);
        for number in 0..1000 {
            hub.publish_snapshot(Picture { number, ..Picture::default() });
        }
        assert!(
            matches!(messages.try_recv(), Err(TryRecvError::Lagged(missed)) if missed == 1000 - MAX_QUEUED_MESSAGES as u64)
        );
        let left: Vec<_> = std::iter::from_fn(|| messages.try_recv().ok()).collect();
        assert_eq!(left.len(), MAX_QUEUED_MESSAGES, "the newest are kept");
    }

    #[test]
    fn catch_up_includes_events_and_flags_of_missed_snapshots() {
        let hub = Hub::default();
        let events = vec![SystemEvent { number: 7, ..SystemEvent::default() }];
        hub.publish_snapshot(Picture { events, flags: 0b100, ..Picture::default() });
        (0..20).for_each(|_| hub.publish_snapshot(Picture { flags: 0b1, ..Picture::default() }));
        let catch_up = |missed| match ToPage::from_bytes(&hub.catch_up(missed)[0]).unwrap().said {
            Some(Said::Picture(past)) => (past.events.iter().map(|event| event.number).collect::<Vec<_>>(), past.flags),
            other => panic!("{other:?}"),
        };
        assert_eq!(catch_up(13), (vec![7], 0b101));
        assert_eq!(catch_up(1), (vec![7], 0b1), "flags of received snapshots are not repeated");
    }

    #[test]
    fn new_viewer_receives_earlier_events() {
        let hub = Hub::default();
        for number in 0..(MAX_EVENTS as u64 + 10) {
            let events = vec![SystemEvent { number, ..SystemEvent::default() }];
            hub.publish_snapshot(Picture { events, ..Picture::default() });
        }
        let (first, _) = hub.subscribe();
        let past = ToPage::from_bytes(&first[1]).unwrap();
        let Some(Said::Picture(past)) = past.said else { panic!("{past:?}") };
        assert_eq!((past.events.len(), past.events[0].number), (MAX_EVENTS, 10));
    }
}
