//! Subscriptions to every topic of the bus, for a recorder.
//!
//! The subscriptions are opened before any service starts and have the buffer sizes of the data
//! path. In lockstep no message is overwritten before it is recorded, because the source may
//! publish new ticks only after the recorder has read.

use bus::{Bus, BusError};
use flight::Recorder;
use graph::Topic;
use messages::Message;
use runtime::ServiceConfig;

/// Function that passes the received messages of one topic to the recorder.
type DrainTopic = Box<dyn Fn(&mut Recorder)>;

pub(super) struct RecordedTopics(Vec<DrainTopic>);

impl RecordedTopics {
    pub(super) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Self, BusError> {
        let each = Topic::ALL.iter().map(|topic| messages::dispatch!(*topic, M => open::<M>(*topic, bus, config)));
        Ok(Self(each.collect::<Result<_, _>>()?))
    }

    /// Passes the received messages to the recorder and marks the end of the round.
    pub(super) fn poll(&self, recorder: &mut Recorder) {
        self.0.iter().for_each(|drain| drain(recorder));
        recorder.poll();
    }
}

fn open<M: Message>(topic: Topic, bus: &Bus, config: &ServiceConfig) -> Result<DrainTopic, BusError> {
    let buffer = config.buffer_size(M::TOPIC);
    let subscriber = bus.subscriber::<M>(buffer)?;
    Ok(Box::new(move |recorder| {
        let mut count = 0;
        let result = subscriber.drain(2 * buffer, |message| {
            count += 1;
            recorder.record(topic, bytemuck::bytes_of(&message));
        });
        // A failed read is handled like an overflow, because it affects only the recording.
        if count >= buffer || result.is_err() {
            recorder.record_overflow(topic);
        }
    }))
}
