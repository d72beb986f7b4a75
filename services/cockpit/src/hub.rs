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

use crate::{calibration::Wish, picture::EVENTS_MAX};

/// Pictures whose flags are kept for viewers who missed them: two seconds.
const FLAGS_KEPT: usize = 64;
/// Messages that a viewer may be behind before it misses some: a quarter of a second.
const BEHIND_MAX: usize = 8;

/// What viewers are told.
#[derive(Debug)]
pub struct Hub {
    told: broadcast::Sender<Bytes>,
    last: Mutex<Last>,
    /// That a calibration begin, or that the one under way end; who makes pictures has not yet seen to it.
    wished: Mutex<Option<Option<Wish>>>,
    /// What viewers of the Foxglove WebSocket protocol are told.
    #[cfg(feature = "foxglove")]
    pub(crate) live: std::sync::Arc<crate::foxglove::feed::Live>,
}

/// What a viewer who comes later is told first, and whoever asks once.
#[derive(Debug, Default)]
struct Last {
    newest: Newest,
    events: VecDeque<SystemEvent>,
    /// Of the newest pictures.
    flags: VecDeque<u64>,
    calibration: Option<Calibration>,
}

/// The newest of what is known.
#[derive(Debug, Clone, Default)]
pub(crate) struct Newest {
    pub(crate) standing: Standing,
    /// Of the system that runs.
    pub(crate) attitude: Option<AttitudeOutput>,
    /// The gyro's, body axes.
    pub(crate) bias_rad_s: Option<[f64; 3]>,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            told: broadcast::Sender::new(BEHIND_MAX),
            last: Mutex::default(),
            wished: Mutex::default(),
            #[cfg(feature = "foxglove")]
            live: std::sync::Arc::default(),
        }
    }
}

impl Hub {
    /// Shows a picture to whoever looks.
    pub fn show(&self, picture: Picture) {
        let mut last = self.last();
        last.events.extend(picture.events.iter().cloned());
        let more = last.events.len().saturating_sub(EVENTS_MAX);
        last.events.drain(..more);
        if last.flags.len() == FLAGS_KEPT {
            last.flags.pop_front();
        }
        last.flags.push_back(picture.flags);
        if picture.attitude.is_some() {
            last.newest.attitude = picture.attitude;
        }
        if let Some(bias) = picture.fused.as_ref().and_then(|fused| fused.bias_rad_s.as_ref()) {
            last.newest.bias_rad_s = Some([bias.x, bias.y, bias.z]);
        }
        drop(last);
        if self.told.receiver_count() > 0 {
            self.say(Said::Picture(picture));
        }
    }

    /// Tells how the system is.
    pub fn tell(&self, standing: Standing) {
        let mut last = self.last();
        if standing.state() != State::Live {
            last.newest = Newest::default();
        }
        last.newest.standing = standing.clone();
        drop(last);
        self.say(Said::Standing(standing));
    }

    /// Tells how a calibration does.
    pub(crate) fn tell_calibration(&self, calibration: Calibration) {
        self.last().calibration = Some(calibration.clone()).filter(|calibration| !calibration.what.is_empty());
        self.say(Said::Calibration(calibration));
    }

    /// Asks that a calibration begin, or that the one under way end.
    pub(crate) fn calibrate(&self, wish: Option<Wish>) {
        *self.wished.lock().unwrap_or_else(PoisonError::into_inner) = Some(wish);
    }

    /// What was asked for since the last time.
    pub(crate) fn wished(&self) -> Option<Option<Wish>> {
        self.wished.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Somebody looks.
    pub fn is_watched(&self) -> bool {
        #[cfg(feature = "foxglove")]
        let others = self.live.is_watched();
        #[cfg(not(feature = "foxglove"))]
        let others = false;
        self.told.receiver_count() > 0 || others
    }

    /// What a new viewer is told first, and what follows.
    pub(crate) fn join(&self) -> (Vec<Bytes>, Receiver<Bytes>) {
        let told = self.told.subscribe();
        let last = self.last();
        let first = [Said::Standing(last.newest.standing.clone()), Said::Picture(last.past(0))];
        let calibration = last.calibration.clone().map(Said::Calibration);
        (first.into_iter().chain(calibration).map(message).collect(), told)
    }

    /// What a viewer who missed so many messages is told in their place: events and flags are not thinned, and a calibration tells what it
    /// found only once.
    pub(crate) fn missed(&self, messages: u64) -> [Bytes; 2] {
        let last = self.last();
        // Those that still wait for it may have gone by the time it is told.
        let picture = last.past(messages as usize + BEHIND_MAX);
        [Said::Picture(picture), Said::Calibration(last.calibration.clone().unwrap_or_default())].map(message)
    }

    /// What is known now.
    pub(crate) fn newest(&self) -> Newest {
        self.last().newest.clone()
    }

    fn say(&self, said: Said) {
        // Without viewers there is nobody to be told.
        let _ = self.told.send(message(said));
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Last {
    /// All events, and the flags of the newest pictures.
    fn past(&self, pictures: usize) -> Picture {
        let flags = self.flags.iter().rev().take(pictures).fold(0, |all, flags| all | flags);
        Picture { events: self.events.iter().cloned().collect(), flags, ..Picture::default() }
    }
}

pub(crate) fn message(said: Said) -> Bytes {
    ToPage { said: Some(said) }.encoded().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::broadcast::error::TryRecvError;

    #[test]
    fn a_viewer_who_does_not_read_misses_pictures_and_holds_up_nobody() {
        let hub = Hub::default();
        let (first, mut told) = hub.join();
        assert_eq!(first.len(), 2);
        for number in 0..1000 {
            hub.show(Picture { number, ..Picture::default() });
        }
        assert!(matches!(told.try_recv(), Err(TryRecvError::Lagged(missed)) if missed == 1000 - BEHIND_MAX as u64));
        let left: Vec<_> = std::iter::from_fn(|| told.try_recv().ok()).collect();
        assert_eq!(left.len(), BEHIND_MAX, "and has the newest");
    }

    #[test]
    fn who_missed_pictures_is_told_of_what_happened_in_them() {
        let hub = Hub::default();
        let events = vec![SystemEvent { number: 7, ..SystemEvent::default() }];
        hub.show(Picture { events, flags: 0b100, ..Picture::default() });
        (0..20).for_each(|_| hub.show(Picture { flags: 0b1, ..Picture::default() }));
        let told = |missed| match ToPage::decoded(&hub.missed(missed)[0]).unwrap().said {
            Some(Said::Picture(past)) => (past.events.iter().map(|event| event.number).collect::<Vec<_>>(), past.flags),
            other => panic!("{other:?}"),
        };
        assert_eq!(told(13), (vec![7], 0b101));
        assert_eq!(told(1), (vec![7], 0b1), "what it has seen is no news");
    }

    #[test]
    fn who_comes_later_is_told_of_the_events_before() {
        let hub = Hub::default();
        for number in 0..(EVENTS_MAX as u64 + 10) {
            let events = vec![SystemEvent { number, ..SystemEvent::default() }];
            hub.show(Picture { events, ..Picture::default() });
        }
        let (first, _) = hub.join();
        let past = ToPage::decoded(&first[1]).unwrap();
        let Some(Said::Picture(past)) = past.said else { panic!("{past:?}") };
        assert_eq!((past.events.len(), past.events[0].number), (EVENTS_MAX, 10));
    }
}
