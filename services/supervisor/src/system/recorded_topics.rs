//! Subscriptions to every topic of the bus, for a recorder.
//!
//! The subscriptions are opened before any service starts and have the buffer sizes of the data
//! path. In lockstep no message is overwritten before it is recorded, because the source may
//! publish new ticks only after the recorder has read.

use std::collections::BTreeMap;

use bus::{Bus, BusError};
use flight::Recorder;
use graph::{Service, Topic};
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
    // A subscriber has a buffer for each publisher. If there are several, each message contains the
    // incarnation of its publisher.
    let publishers = if M::TOPIC.publisher.is_many() { Service::ALL.len() } else { 1 };
    let incarnation = messages::layout(topic).fields.into_iter().find(|field| field.name == "incarnation");
    let range = incarnation.filter(|_| publishers > 1).map(|field| field.offset..field.offset + size_of::<u32>());
    let publisher_of = move |bytes: &[u8]| -> Option<u32> {
        range.clone().and_then(|range| bytes.get(range)?.try_into().ok()).map(u32::from_ne_bytes)
    };
    Ok(Box::new(move |recorder| {
        let mut counts = BTreeMap::new();
        let result = subscriber.drain(2 * buffer * publishers, |message| {
            let bytes = bytemuck::bytes_of(&message);
            *counts.entry(publisher_of(bytes)).or_insert(0) += 1;
            recorder.record(topic, bytes);
        });
        // A failed read is handled like an overflow, because it affects only the recording.
        if counts.values().any(|count| *count >= buffer) || result.is_err() {
            recorder.record_overflow(topic);
        }
    }))
}

#[cfg(test)]
mod tests {
    use bus::SystemName;
    use flight::{FlightHeader, RecordingMode};
    use launch::Launch;
    use messages::Health;
    use runtime::{Pace, service_config::CONTROL_BUFFER};

    use super::*;

    /// Returns the number of missed messages that is reported after each of `publishers` processes
    /// has published `reports` health reports.
    fn missed(publishers: u32, reports: usize) -> u64 {
        let name = SystemName::new(&format!("test-recorded-{}-{publishers}-{reports}", std::process::id())).unwrap();
        let _claim = name.claim().unwrap();
        let bus = Bus::join(&name, "test").unwrap();
        let launch = Launch { name: name.name().into(), ..Launch::default() };
        let config = ServiceConfig::standalone(launch, 100.0, Pace::Speed(1.0));
        let folder = tempfile::tempdir().unwrap();
        let (path, header) = (folder.path().join("flight.mcap"), FlightHeader::new("test", &config));
        let mut recorder = Recorder::create(&path, &header, &[Topic::Health], RecordingMode::FromFirstTick).unwrap();
        let drain = open::<Health>(Topic::Health, &bus, &config).unwrap();
        let publish = |incarnation| {
            let publisher = bus.publisher::<Health>(CONTROL_BUFFER).unwrap();
            let health = Health { incarnation, ..bytemuck::Zeroable::zeroed() };
            (0..reports).for_each(|_| publisher.send(&health).unwrap());
            publisher
        };
        let _publishers: Vec<_> = (0..publishers).map(publish).collect();
        drain(&mut recorder);
        let summary = recorder.finish("test ended", None);
        assert_eq!(summary.messages, u64::from(publishers) * reports.min(CONTROL_BUFFER) as u64);
        summary.missed
    }

    #[test]
    fn only_full_buffer_of_one_publisher_counts_as_missed() {
        assert_eq!(missed(5, CONTROL_BUFFER - 1), 0);
        assert_eq!(missed(1, CONTROL_BUFFER), 1);
        assert_eq!(missed(1, CONTROL_BUFFER + 1), 1);
    }
}
