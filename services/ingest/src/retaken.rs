//! The samples of a flight, made again of what ingest took in it.
//!
//! Input: messages of the topic `reading` in the order of their recording. Output: the samples of the flight. Time: the readings' own. Failure: a
//! reading that is not there ends it: what would follow is another flight.

use messages::TakenReading;
use runtime::ServiceConfig;

use crate::{
    conditioner::{Conditioner, Sample},
    source::{Reading, SourceError},
};

/// Makes samples of readings that were taken.
pub struct Retaken {
    config: ServiceConfig,
    conditioner: Conditioner,
    /// Readings have no number that every incarnation gives them.
    from_bus: bool,
    /// The incarnation of ingest whose reading came last, and its next.
    last: Option<(u32, u64)>,
    refused: u64,
}

/// Readings that a recording does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "replaying a flight: its recording lacks the readings {from} to {until}; it was not made by `plumb up --record`, or the recorder was too slow"
)]
pub struct LostReadings {
    from: u64,
    until: u64,
}

impl Retaken {
    /// For a flight of this configuration.
    pub fn new(config: &ServiceConfig) -> Result<Self, SourceError> {
        let from_bus = !config.launch.ingest.source.is_repeatable();
        Ok(Self { conditioner: crate::conditioner(config)?, config: config.clone(), from_bus, last: None, refused: 0 })
    }

    /// The sample of a reading; none of one that came again, was refused, or is gone by the script of faults.
    pub fn sample(&mut self, taken: &TakenReading) -> Result<Option<Sample>, RetakeError> {
        let TakenReading { number, incarnation, tick, offset_ns, .. } = *taken;
        let same = self.last.filter(|(last, _)| *last == incarnation || !self.from_bus);
        let next = same.map_or(0, |(_, next)| next);
        if number < next {
            return Ok(None);
        }
        if number > next {
            return Err(LostReadings { from: next, until: number - 1 }.into());
        }
        if self.from_bus && same.is_none() && self.last.is_some() {
            // Of the one before, nothing is known to the one that goes on for it but the tick and the offset.
            self.refused += self.conditioner.refused();
            self.conditioner = crate::conditioner(&self.config)?;
            self.conditioner.continue_at(tick, offset_ns);
        }
        self.last = Some((incarnation, number + 1));
        let reading = Reading::from(taken);
        Ok(self.conditioner.condition(&reading))
    }

    /// Ticks given so far.
    pub fn ticks(&self) -> u64 {
        self.conditioner.ticks()
    }

    /// Readings refused so far.
    pub fn refused(&self) -> u64 {
        self.refused + self.conditioner.refused()
    }
}

/// Why no samples are made of readings that were taken.
#[derive(Debug, thiserror::Error)]
pub enum RetakeError {
    /// Some are not there.
    #[error(transparent)]
    Lost(#[from] LostReadings),
    /// The sensors cannot be placed.
    #[error(transparent)]
    Source(#[from] SourceError),
}
