//! Reconstructs the samples of a flight from its recorded raw readings.
//!
//! Input: messages of the topic `reading` in the order of the recording.
//!
//! Output: the samples of the flight.
//!
//! Time: that of the readings.
//!
//! Failure: a missing reading ends the replay, because the samples after it would differ from the
//! flight.

use messages::TakenReading;
use runtime::ServiceConfig;

use crate::{
    conditioner::{Conditioner, Sample},
    source::{Reading, SourceError},
};

/// Replay of a flight: conditions its recorded readings.
pub struct FlightReplay {
    config: ServiceConfig,
    conditioner: Conditioner,
    /// `true` if the readings came from the bus. Each incarnation of ingest then numbers its
    /// readings from 0.
    is_from_bus: bool,
    /// Incarnation of ingest that published the last reading, and the number that its next reading
    /// must have.
    last: Option<(u32, u64)>,
    rejected: u64,
}

/// Error for a range of readings that is missing from the recording.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "replaying a flight: the recording lacks readings {from} to {until}; either it was not recorded by `plumb up --record`, or the recorder was too slow"
)]
pub struct MissingReadings {
    from: u64,
    until: u64,
}

impl FlightReplay {
    /// Creates a replay of a flight with the given configuration.
    ///
    /// # Errors
    ///
    /// Returns an error if a calibration or the mounting is invalid.
    pub fn new(config: &ServiceConfig) -> Result<Self, SourceError> {
        let is_from_bus = !config.launch.ingest.source.is_repeatable();
        Ok(Self {
            conditioner: crate::conditioner(config)?,
            config: config.clone(),
            is_from_bus,
            last: None,
            rejected: 0,
        })
    }

    /// Returns the sample of a reading, or `None` if it is a duplicate, was rejected, or is dropped
    /// by an injected fault.
    ///
    /// # Errors
    ///
    /// Returns an error if readings before this one are missing.
    pub fn sample(&mut self, raw: &TakenReading) -> Result<Option<Sample>, FlightReplayError> {
        let TakenReading { number, incarnation, tick, offset_ns, .. } = *raw;
        let current = self.last.filter(|(last, _)| *last == incarnation || !self.is_from_bus);
        let next = current.map_or(0, |(_, next)| next);
        if number < next {
            return Ok(None);
        }
        if number > next {
            return Err(MissingReadings { from: next, until: number - 1 }.into());
        }
        if self.is_from_bus && current.is_none() && self.last.is_some() {
            // In the flight, the new incarnation of ingest resumed with only the tick and the clock
            // offset, so the replay discards all other state as well.
            self.rejected += self.conditioner.rejected();
            self.conditioner = crate::conditioner(&self.config)?;
            self.conditioner.resume_at(tick, offset_ns);
        }
        self.last = Some((incarnation, number + 1));
        let reading = Reading::from(raw);
        Ok(self.conditioner.condition(&reading))
    }

    /// Returns the number of ticks so far.
    pub fn ticks(&self) -> u64 {
        self.conditioner.ticks()
    }

    /// Returns the number of rejected readings so far.
    pub fn rejected(&self) -> u64 {
        self.rejected + self.conditioner.rejected()
    }
}

/// Error of a flight replay.
#[derive(Debug, thiserror::Error)]
pub enum FlightReplayError {
    /// Readings are missing from the recording.
    #[error(transparent)]
    MissingReadings(#[from] MissingReadings),
    /// A calibration or the mounting is invalid.
    #[error(transparent)]
    Source(#[from] SourceError),
}
