//! Every topic of the bus, read for a recorder.
//!
//! The readers are there before any service, and hold as much as those of the path: what is read in each round is whole, in lockstep because
//! the source goes no further than the credit that is granted after the round.

use bus::{Bus, BusError, Subscriber};
use graph::Topic;
use messages::Message;
use runtime::ServiceConfig;

use crate::recorder::Recorder;

pub(super) struct Recorded(Vec<Box<dyn RecordedTopic>>);

impl Recorded {
    pub(super) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Self, BusError> {
        let each = Topic::ALL.iter().map(|topic| messages::dispatch!(*topic, M => open::<M>(*topic, bus, config)));
        Ok(Self(each.collect::<Result<_, _>>()?))
    }

    /// Hands over what has come.
    pub(super) fn look(&self, recorder: &mut dyn Recorder) {
        self.0.iter().for_each(|topic| topic.look(recorder));
        recorder.look();
    }
}

trait RecordedTopic {
    fn look(&self, recorder: &mut dyn Recorder);
}

struct Reading<M: Message> {
    topic: Topic,
    subscriber: Subscriber<M>,
    buffer: usize,
}

fn open<M: Message>(topic: Topic, bus: &Bus, config: &ServiceConfig) -> Result<Box<dyn RecordedTopic>, BusError> {
    let buffer = config.buffer(M::TOPIC);
    Ok(Box::new(Reading::<M> { topic, subscriber: bus.subscriber(buffer)?, buffer }))
}

impl<M: Message> RecordedTopic for Reading<M> {
    fn look(&self, recorder: &mut dyn Recorder) {
        let mut taken = 0;
        let read = self.subscriber.drain(2 * self.buffer, |message| {
            taken += 1;
            recorder.take(self.topic, bytemuck::bytes_of(&message));
        });
        // What cannot be read costs the recording and nothing else.
        if taken >= self.buffer || read.is_err() {
            recorder.overflowed(self.topic);
        }
    }
}
