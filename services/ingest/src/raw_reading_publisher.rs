//! Publishes the raw readings of ingest on the topic `reading`, so that a flight can be replayed.
//!
//! Input: readings in the order in which they are processed.
//!
//! Output: messages from which the same readings can be reconstructed.

use bus::{BusError, Publisher};
use messages::TakenReading;
use readings::{conditioner::Conditioner, source::Reading};
use runtime::ServiceConfig;

/// Publisher of raw readings.
pub(crate) struct RawReadingPublisher {
    publisher: Publisher<TakenReading>,
    incarnation: u32,
    number: u64,
    /// First tick for which readings are published. An earlier incarnation has published the
    /// readings of the ticks before it.
    first_tick: u64,
}

impl RawReadingPublisher {
    pub(crate) fn new(publisher: Publisher<TakenReading>, config: &ServiceConfig, first_tick: u64) -> Self {
        Self { publisher, incarnation: config.incarnation, number: 0, first_tick }
    }

    /// Publishes a reading. Must be called before the conditioner processes the reading.
    pub(crate) fn publish(&mut self, reading: &Reading, conditioner: &Conditioner) -> Result<(), BusError> {
        let number = self.number;
        self.number += 1;
        if conditioner.ticks() < self.first_tick {
            return Ok(());
        }
        let (tick, offset_ns) = (conditioner.ticks(), conditioner.offset_ns());
        let incarnation = self.incarnation;
        self.publisher.send(&TakenReading { number, tick, offset_ns, incarnation, ..reading.into() })
    }
}
