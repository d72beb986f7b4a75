//! Publication of measurements to ingest, as readings and fixes.

use std::collections::VecDeque;

use bus::{BusError, Publisher};
use decoders::Measurement;
use launch::Stream;
use messages::{ReceiverReading, SensorReading};
use runtime::{RuntimeError, ServiceContext};

use crate::reading_converter::{DeviceReading, ReadingConverter};

/// Publisher of readings and fixes, with a queue of those that ingest has no room for yet.
pub(crate) struct ReadingPublisher {
    /// Publisher of readings; `None` if another program publishes them.
    sensor: Option<Publisher<SensorReading>>,
    receiver: Publisher<ReceiverReading>,
    pub(crate) converter: ReadingConverter,
    queue: VecDeque<DeviceReading>,
    /// Maximum number of readings that are sent but not yet consumed by ingest; `None` if the
    /// source is not paced by ingest.
    max_in_flight: Option<u64>,
    sent: u64,
}

impl ReadingPublisher {
    /// Opens the publisher. `stream` describes the source, or is `None` if the service reads only a
    /// receiver.
    pub(crate) fn open(context: &ServiceContext, stream: Option<&Stream>) -> Result<Self, RuntimeError> {
        let sensor = stream.map(|_| context.publisher::<SensorReading>()).transpose()?;
        if let Some(sensor) = sensor.as_ref().filter(|_| context.config.resume.is_some()) {
            sensor.mark_all_consumed();
        }
        // Only half of the buffer is used. The number of readings in flight may be miscounted if
        // either process dies, and the other half of the buffer absorbs the error.
        let half_buffer = context.config.buffer_ticks() as u64 / 2;
        Ok(Self {
            sensor,
            receiver: context.publisher()?,
            converter: ReadingConverter::new(stream),
            queue: VecDeque::new(),
            max_in_flight: context.config.is_lockstep().then_some(half_buffer.max(1)),
            sent: 0,
        })
    }

    /// Returns the number of readings sent.
    pub(crate) fn sent(&self) -> u64 {
        self.sent
    }

    /// Queues a measurement that arrived at `arrival_ns` on CLOCK_MONOTONIC.
    pub(crate) fn push(&mut self, measurement: &Measurement, arrival_ns: i64) {
        self.queue.extend(self.converter.convert(measurement, arrival_ns));
    }

    /// Sends as many queued messages as ingest has room for. Returns `true` if the queue is empty.
    pub(crate) fn flush(&mut self) -> Result<bool, BusError> {
        let unconsumed = self.sensor.as_ref().map_or(0, Publisher::unconsumed);
        let mut room = self.max_in_flight.map_or(u64::MAX, |max_in_flight| max_in_flight.saturating_sub(unconsumed));
        let previously_sent = self.sent;
        while let Some(outgoing) = self.queue.front() {
            match outgoing {
                DeviceReading::Sensor(_) if room == 0 => break,
                DeviceReading::Sensor(reading) => {
                    if let Some(sensor) = &self.sensor {
                        // The reading is counted after it is sent, so that ingest finds every
                        // counted reading in the topic unless it was overwritten.
                        sensor.send(reading)?;
                        sensor.add_sent(1);
                    }
                    (room, self.sent) = (room - 1, self.sent + 1);
                }
                DeviceReading::Fix(fix) => self.receiver.send(fix)?,
            }
            self.queue.pop_front();
        }
        if self.sent != previously_sent {
            self.sensor.iter().for_each(Publisher::wake);
        }
        Ok(self.queue.is_empty())
    }

    /// Delivers the publishers' history to an ingest process that has just joined.
    pub(crate) fn deliver_history(&self) -> Result<(), BusError> {
        self.sensor.iter().try_for_each(Publisher::deliver_history)?;
        self.receiver.deliver_history()
    }
}
