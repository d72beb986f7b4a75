//! Between who makes pictures and who sends them: each viewer has the newest few, and whoever is slower misses some.

use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
};

use axum::body::Bytes;
use tokio::sync::broadcast::{self, Receiver};
use wire::{
    command::ControlMessage,
    v1::{AttitudeOutput, Calibration, Picture, Standing, SystemEvent, ToPage, standing::State, to_page::Said},
};

use crate::{calibration::CalibrationRequest, picture::MAX_EVENTS};

/// Pictures whose flags are kept for viewers who missed them: two seconds.
const MAX_STORED_FLAGS: usize = 64;
/// Messages that a viewer may be behind before it misses some: a quarter of a second.
const MAX_QUEUED_MESSAGES: usize = 8;

/// What viewers are told.
#[derive(Debug)]
pub struct Hub {
    messages: broadcast::Sender<Bytes>,
    backlog: Mutex<Backlog>,
    /// That a calibration begin, or that the one under way end; who makes pictures has not yet seen to it.
    calibration_request: Mutex<Option<Option<CalibrationRequest>>>,
    /// What viewers of the Foxglove WebSocket protocol are told.
    #[cfg(feature = "foxglove")]
    pub(crate) broadcaster: std::sync::Arc<crate::foxglove::feed::Live>,
}

/// What a viewer who comes later is told first, and whoever asks once.
#[derive(Debug, Default)]
struct Backlog {
    latest: LatestState,
    events: VecDeque<SystemEvent>,
    /// Of the newest pictures.
    flags: VecDeque<u64>,
    calibration: Option<Calibration>,
}

/// The newest of what is known.
#[derive(Debug, Clone, Default)]
pub(crate) struct LatestState {
    pub(crate) standing: Standing,
    /// Of the system that runs.
    pub(crate) attitude: Option<AttitudeOutput>,
    /// The gyro's, body axes.
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
    /// Shows a picture to whoever looks.
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
        drop(backlog);
        if self.messages.receiver_count() > 0 {
            self.send(Said::Picture(picture));
        }
    }

    /// Tells how the system is.
    pub fn publish_status(&self, standing: Standing) {
        let mut backlog = self.backlog();
        if standing.state() != State::Live {
            backlog.latest = LatestState::default();
        }
        backlog.latest.standing = standing.clone();
        drop(backlog);
        self.send(Said::Standing(standing));
    }

    /// Tells how a calibration does.
    pub(crate) fn publish_calibration(&self, calibration: Calibration) {
        self.backlog().calibration = Some(calibration.clone()).filter(|calibration| !calibration.what.is_empty());
        self.send(Said::Calibration(calibration));
    }

    /// Asks that a calibration begin, or that the one under way end.
    pub(crate) fn request_calibration(&self, request: Option<CalibrationRequest>) {
        *self.calibration_request.lock().unwrap_or_else(PoisonError::into_inner) = Some(request);
    }

    /// What was asked for since the last time.
    pub(crate) fn take_calibration_request(&self) -> Option<Option<CalibrationRequest>> {
        self.calibration_request.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Somebody looks.
    pub fn has_viewers(&self) -> bool {
        #[cfg(feature = "foxglove")]
        let has_foxglove_clients = self.broadcaster.is_watched();
        #[cfg(not(feature = "foxglove"))]
        let others = false;
        self.messages.receiver_count() > 0 || has_foxglove_clients
    }

    /// What a new viewer is told first, and what follows.
    pub(crate) fn subscribe(&self) -> (Vec<Bytes>, Receiver<Bytes>) {
        let messages = self.messages.subscribe();
        let backlog = self.backlog();
        let first = [Said::Standing(backlog.latest.standing.clone()), Said::Picture(backlog.summary(0))];
        let calibration = backlog.calibration.clone().map(Said::Calibration);
        (first.into_iter().chain(calibration).map(encode).collect(), messages)
    }

    /// What a viewer who missed so many messages is told in their place: events and flags are not thinned, and a calibration tells what it
    /// found only once.
    pub(crate) fn catch_up(&self, messages: u64) -> [Bytes; 2] {
        let backlog = self.backlog();
        // Those that still wait for it may have gone by the time it is told.
        let picture = backlog.summary(messages as usize + MAX_QUEUED_MESSAGES);
        [Said::Picture(picture), Said::Calibration(backlog.calibration.clone().unwrap_or_default())].map(encode)
    }

    /// What is known now.
    pub(crate) fn latest(&self) -> LatestState {
        self.backlog().latest.clone()
    }

    fn send(&self, said: Said) {
        // Without viewers there is nobody to be told.
        let _ = self.messages.send(encode(said));
    }

    fn backlog(&self) -> MutexGuard<'_, Backlog> {
        self.backlog.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backlog {
    /// All events, and the flags of the newest pictures.
    fn summary(&self, pictures: usize) -> Picture {
        let flags = self.flags.iter().rev().take(pictures).fold(0, |all, flags| all | flags);
        Picture { events: self.events.iter().cloned().collect(), flags, ..Picture::default() }
    }
}

pub(crate) fn encode(said: Said) -> Bytes {
    ToPage { said: Some(said) }.to_bytes().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::broadcast::error::TryRecvError;

    #[test]
    fn slow_viewer_misses_snapshots_without_blocking() {
        let hub = Hub::default();
        let (first, mut messages) = hub.subscribe();
        assert_eq!(first.len(), 2);
        for number in 0..1000 {
            hub.publish_snapshot(Picture { number, ..Picture::default() });
        }
        assert!(matches!(messages.try_recv(), Err(TryRecvError::Lagged(missed)) if missed == 1000 - MAX_QUEUED_MESSAGES as u64));
        let left: Vec<_> = std::iter::from_fn(|| messages.try_recv().ok()).collect();
        assert_eq!(left.len(), MAX_QUEUED_MESSAGES, "and has the newest");
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
        assert_eq!(catch_up(1), (vec![7], 0b1), "what it has seen is no news");
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
