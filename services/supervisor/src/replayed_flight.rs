//! Reconstructs a recorded flight for replay, from its events and the readings of its source.
//!
//! - Input: messages of the topics `event` and `reading`, in publication order.
//! - Output: the launch file, the tick of each stage's takeover, and the prior of the run.
//! - Failure: a flight without a start event is rejected.

use launch::{Date, ExternalStage, Launch, Slot, Source};
use messages::{EventKind, SystemEvent, TakenReading};
use pipeline::Schedule;
use runtime::Prior;

use crate::error::UpError;

/// Recorded readings in order. An error ends the iteration; its text is shown to the user.
pub type TakenReadings = Box<dyn Iterator<Item = Result<TakenReading, String>>>;

/// Recorded flight, prepared for a replay.
pub struct Flight {
    /// Launch configuration of the flight, including the sensor source that it used.
    pub launch: Launch,
    /// Sample rate on the clock of the source, Hz.
    pub rate_hz: f64,
    /// Sensor errors known at the start, from a warm start; `None` after a cold start.
    pub prior: Option<Prior>,
    /// Stage that fills each slot, by tick.
    pub schedule: Schedule,
    /// Recorded readings of the source.
    pub readings: TakenReadings,
}

impl std::fmt::Debug for Flight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rate_hz, prior, schedule, .. } = self;
        f.debug_struct("Flight").field("rate_hz", rate_hz).field("prior", prior).field("schedule", schedule).finish()
    }
}

/// Sources, in the order of their numbers in the start event of a run.
const SOURCES: [Source; 9] = [
    Source::Sim,
    Source::Replay,
    Source::Bus,
    Source::Stdin,
    Source::Udp,
    Source::Serial,
    Source::Tcp,
    Source::Mavlink,
    Source::Iio,
];
const RATE: &str = "rate_hz";
const SOURCE: &str = "source";
const DATE: &str = "date";

/// Creates the start event of a run. It contains the sample rate, the source and, if used, the date
/// for the magnetic model.
pub(crate) fn start_event(rate_hz: f64, launch: &Launch) -> SystemEvent {
    let index = SOURCES.iter().position(|other| *other == launch.ingest.source).unwrap_or(0);
    let date = launch.north.date.filter(|_| launch.north.is_true).map(|date| (DATE, date.number().into()));
    SystemEvent::new(EventKind::STARTED)
        .with_stage("", [(RATE, rate_hz), (SOURCE, index as f64)].into_iter().chain(date))
}

impl Flight {
    /// Creates a flight from its launch file, events and readings.
    ///
    /// # Errors
    ///
    /// Returns an error if the events do not contain a valid start event.
    pub fn new(mut launch: Launch, events: &[SystemEvent], readings: TakenReadings) -> Result<Self, UpError> {
        let is_start =
            |event: &&SystemEvent| event.kind == EventKind::STARTED && event.service == SystemEvent::NONE_U32;
        let settings = events.iter().find(is_start).and_then(SystemEvent::settings).ok_or_else(missing_start)?;
        let number = |name| settings.iter().find(|(other, _)| *other == name).map(|(_, number)| *number);
        let rate_hz = number(RATE).filter(|rate_hz| (1e-3..=1e6).contains(rate_hz)).ok_or_else(missing_start)?;
        let index = number(SOURCE).ok_or_else(missing_start)?;
        launch.ingest.source = *SOURCES.get(index as usize).ok_or_else(missing_start)?;
        // If the launch file has no date, the flight used the current date, which the event
        // contains.
        launch.north.date = launch.north.date.or(number(DATE).and_then(|number| Date::from_number(number as u32)));
        let warm = events.iter().find(|event| event.kind == EventKind::WARM);
        let prior = match warm {
            Some(warm) => {
                Some(warm.settings().and_then(|known| Prior::from_named_values(&known)).ok_or_else(missing_start)?)
            }
            None => None,
        };
        Ok(Self { launch, rate_hz, prior, schedule: Schedule::from_events(events), readings })
    }

    /// Returns a program that the replay would start as a stage, if any, with the name of the
    /// stage.
    pub fn external_stage(&self) -> Option<(&str, &ExternalStage)> {
        let configured = Slot::ALL.into_iter().map(|slot| self.launch.stage(slot).stage.as_str());
        let mut names = configured.chain(self.schedule.stage_names());
        names.find_map(|name| self.launch.stages.get_key_value(name)).map(|(name, stage)| (name.as_str(), stage))
    }
}

fn missing_start() -> UpError {
    UpError::Flight(
        "cannot replay the flight: the start of the run is missing from the recording; record from the start with `plumb up --record`".into(),
    )
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use launch::NorthReference;

    #[test]
    fn replayed_flight_uses_recorded_date() {
        let north = NorthReference { is_true: true, position: None, date: Date::new(2026, 11, 3) };
        let event = start_event(200.0, &Launch { north, ..Launch::default() });
        let replayed_date = |date| {
            let launch = Launch { north: NorthReference { date, ..north }, ..Launch::default() };
            Flight::new(launch, &[event], Box::new(std::iter::empty())).unwrap().launch.north.date
        };
        assert_eq!([replayed_date(None), replayed_date(Date::new(2025, 1, 1))], [north.date, Date::new(2025, 1, 1)]);
        let event =
            start_event(200.0, &Launch { north: NorthReference { is_true: false, ..north }, ..Launch::default() });
        assert_eq!(event.settings().unwrap().len(), 2, "the date is included only if used");
    }
}
