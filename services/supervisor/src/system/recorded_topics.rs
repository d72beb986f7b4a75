//! Subscriptions to every topic of the bus, for a recorder.
//!
//! They are opened before any service starts and have the buffer sizes of the data path. In
//! lockstep each round is complete, because the source receives credit only after the round.

use bus::{Bus, BusError};
use flight::Recorder;
use graph::Topic;
use messages::Message;
use runtime::ServiceConfig;

/// Passes the messages received from a topic to the recorder.
type DrainTopic = Box<dyn Fn(&mut Recorder)>;

pub(super) struct RecordedTopics(Vec<DrainTopic>);

impl RecordedTopics {
    pub(super) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Self, BusError> {
        let each = Topic::ALL.iter().map(|topic| messages::dispatch!(*topic, M => open::<M>(*topic, bus, config)));
        Ok(Self(each.collect::<Result<_, _>>()?))
    }

    /// Passes the messages received to the recorder and ends the round.
    pub(super) fn poll(&self, recorder: &mut Recorder) {
        self.0.iter().for_each(|drain_into| drain_into(recorder));
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
        // A failed read affects only the recording.
        if count >= buffer || result.is_err() {
            recorder.record_overflow(topic);
        }
    }))
}
