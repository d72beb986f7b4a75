//! Subscriptions to every topic of the bus, for a recorder.
//!
//! They are opened before any service starts and have the buffer sizes of the data path. In
//! lockstep each round is complete, because the source receives credit only after the round.

use bus::{Bus, BusError, Subscriber};
use flight::Recorder;
use graph::Topic;
use messages::Message;
use runtime::ServiceConfig;

pub(super) struct RecordedTopics(Vec<Box<dyn DrainTopic>>);

impl RecordedTopics {
    pub(super) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Self, BusError> {
        let each = Topic::ALL.iter().map(|topic| messages::dispatch!(*topic, M => open::<M>(*topic, bus, config)));
        Ok(Self(each.collect::<Result<_, _>>()?))
    }

    /// Passes the messages received to the recorder and ends the round.
    pub(super) fn poll(&self, recorder: &mut Recorder) {
        self.0.iter().for_each(|topic| topic.drain(recorder));
        recorder.poll();
    }
}

trait DrainTopic {
    fn drain(&self, recorder: &mut Recorder);
}

struct TopicReader<M: Message> {
    topic: Topic,
    subscriber: Subscriber<M>,
    buffer: usize,
}

fn open<M: Message>(topic: Topic, bus: &Bus, config: &ServiceConfig) -> Result<Box<dyn DrainTopic>, BusError> {
    let buffer = config.buffer_size(M::TOPIC);
    Ok(Box::new(TopicReader::<M> { topic, subscriber: bus.subscriber(buffer)?, buffer }))
}

impl<M: Message> DrainTopic for TopicReader<M> {
    fn drain(&self, recorder: &mut Recorder) {
        let mut count = 0;
        let result = self.subscriber.drain(2 * self.buffer, |message| {
            count += 1;
            recorder.record(self.topic, bytemuck::bytes_of(&message));
        });
        // A failed read affects only the recording.
        if count >= self.buffer || result.is_err() {
            recorder.record_overflow(self.topic);
        }
    }
}
