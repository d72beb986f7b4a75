//! A flight that is flown again: what was told of it, and what its ingest took.
//!
//! Input: messages of the topics `event` and `reading`, in the order in which they were published. Output: what runs, when which stage takes over,
//! and with what the run began. Time: none. Failure: a flight whose events do not tell how it began is refused.

use launch::{Date, Launch, Source};
use messages::{EventKind, SystemEvent, TakenReading};
use pipeline::Schedule;
use runtime::Prior;

use crate::UpError;

/// Readings as they were recorded, or why there are no more, for people.
pub type TakenReadings = Box<dyn Iterator<Item = Result<TakenReading, String>>>;

/// A flight.
pub struct Flight {
    /// The launch file of the flight; its source is the one that the flight had.
    pub launch: Launch,
    /// Samples per second of the source's time.
    pub rate_hz: f64,
    /// What the run before it had found of the sensors.
    pub prior: Option<Prior>,
    /// Which stage has which slot from which tick on.
    pub schedule: Schedule,
    /// What ingest took.
    pub readings: TakenReadings,
}

impl std::fmt::Debug for Flight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rate_hz, prior, schedule, .. } = self;
        f.debug_struct("Flight").field("rate_hz", rate_hz).field("prior", prior).field("schedule", schedule).finish()
    }
}

/// The sources in the order of their numbers in the event that begins a run.
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

/// The event that begins a run: its rate, its source, and the date of the magnetic model where it is used.
pub(crate) fn beginning(rate_hz: f64, launch: &Launch) -> SystemEvent {
    let place = SOURCES.iter().position(|other| *other == launch.ingest.source).unwrap_or(0);
    let date = launch.north.date.filter(|_| launch.north.is_true).map(|date| (DATE, date.number().into()));
    SystemEvent::new(EventKind::STARTED)
        .with_stage("", [(RATE, rate_hz), (SOURCE, place as f64)].into_iter().chain(date))
}

impl Flight {
    /// A flight that ran `launch`, of which this was told.
    pub fn new(mut launch: Launch, events: &[SystemEvent], readings: TakenReadings) -> Result<Self, UpError> {
        let is_beginning =
            |event: &&SystemEvent| event.kind == EventKind::STARTED && event.service == SystemEvent::NOBODY;
        let settings = events.iter().find(is_beginning).and_then(SystemEvent::settings).ok_or_else(no_beginning)?;
        let number = |name| settings.iter().find(|(other, _)| *other == name).map(|(_, number)| *number);
        let rate_hz = number(RATE).filter(|rate_hz| (1e-3..=1e6).contains(rate_hz)).ok_or_else(no_beginning)?;
        let place = number(SOURCE).ok_or_else(no_beginning)?;
        launch.ingest.source = *SOURCES.get(place as usize).ok_or_else(no_beginning)?;
        // Where the launch file says none it was that of the day.
        launch.north.date = launch.north.date.or(number(DATE).and_then(|number| Date::of_number(number as u32)));
        let warm = events.iter().find(|event| event.kind == EventKind::WARM);
        let prior = match warm {
            Some(warm) => Some(warm.settings().and_then(|known| Prior::of_numbers(&known)).ok_or_else(no_beginning)?),
            None => None,
        };
        Ok(Self { launch, rate_hz, prior, schedule: Schedule::new(events), readings })
    }
}

fn no_beginning() -> UpError {
    UpError::Flight(
        "replaying a flight: its recording does not tell how it began; `plumb up --record` records one from its beginning".into(),
    )
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use launch::North;

    #[test]
    fn a_flight_has_the_date_on_which_it_was_flown() {
        let north = North { is_true: true, position: None, date: Date::new(2026, 11, 3) };
        let begun = beginning(200.0, &Launch { north, ..Launch::default() });
        let again = |date| {
            let carried = Launch { north: North { date, ..north }, ..Launch::default() };
            Flight::new(carried, &[begun], Box::new(std::iter::empty())).unwrap().launch.north.date
        };
        assert_eq!([again(None), again(Date::new(2025, 1, 1))], [north.date, Date::new(2025, 1, 1)]);
        let begun = beginning(200.0, &Launch { north: North { is_true: false, ..north }, ..Launch::default() });
        assert_eq!(begun.settings().unwrap().len(), 2, "it is told where it is used");
    }
}
