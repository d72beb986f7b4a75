//! To the network: each message in its envelope, the signs of life, and the gateway's own report.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use graph::Topic;
use launch::{Launch, Output, Service};
use link::{Link, LinkError, Liveliness, Outlet};
use runtime::clock::monotonic_ns;
use wire::{
    batch::batch_name,
    command::ControlMessage,
    keys,
    v1::{Envelope, GatewayReport, TopicReport},
};

use crate::{QUEUE_MAX, Shared, locked, queue::Batch};

/// Longest time between two turns.
pub(crate) const TURN_LIMIT: Duration = Duration::from_millis(100);
/// Between two reports.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// The last message of each key, with its type.
pub(crate) type Last = Arc<Mutex<BTreeMap<String, (String, Vec<u8>)>>>;

/// The network's end of the queue.
pub(crate) struct Sender {
    link: Link,
    shared: Arc<Shared>,
    outlets: Vec<Option<Channel>>,
    report: Channel,
    start_ns: u64,
    last: Last,
    signs: Vec<(Service, Liveliness)>,
    _vehicle: Liveliness,
    looked: Instant,
    reported: Instant,
}

/// A key and what was sent under it.
struct Channel {
    key: String,
    message: String,
    outlet: Outlet,
    /// In which its samples are.
    output: Output,
    messages: u64,
    samples: u64,
    decimated: u64,
    dropped: u64,
}

impl Sender {
    pub(crate) fn open(link: &Link, shared: Arc<Shared>, launch: &Launch, start_ns: u64) -> Result<Self, LinkError> {
        let vehicle = shared.vehicle.clone();
        let channel = |topic: &str, message: String| {
            let output = if topic == Topic::Attitude.name() { launch.output } else { Output::default() };
            Channel::open(link, keys::key(&vehicle, topic), message, output)
        };
        let rates = &launch.gateway.rates;
        let outlets = Topic::ALL
            .iter()
            .map(|topic| rates.contains_key(topic.name()).then(|| channel(topic.name(), batch_of(*topic))).transpose());
        Ok(Self {
            outlets: outlets.collect::<Result<_, _>>()?,
            report: channel(keys::GATEWAY, format!("plumbline.v1.{}", GatewayReport::NAME))?,
            start_ns,
            last: Last::default(),
            signs: Vec::new(),
            _vehicle: link.sign(&keys::key(&vehicle, keys::LIVE))?,
            link: link.clone(),
            shared,
            looked: Instant::now(),
            reported: Instant::now(),
        })
    }

    /// The last message of each key.
    pub(crate) fn last(&self) -> Last {
        self.last.clone()
    }

    /// Sends what there is.
    pub(crate) fn empty(&mut self) {
        for _ in 0..QUEUE_MAX {
            let Some((batch, dropped)) = self.shared.queue.take() else { break };
            self.send(&batch, dropped);
        }
    }

    /// Sends what there is, and from time to time what is not on the bus.
    pub(crate) fn poll(&mut self) -> Result<(), LinkError> {
        self.empty();
        if self.looked.elapsed() > TURN_LIMIT {
            self.looked = Instant::now();
            self.see_who_lives()?;
        }
        if self.reported.elapsed() > REPORT_INTERVAL {
            self.reported = Instant::now();
            self.publish_report();
        }
        Ok(())
    }

    fn send(&mut self, batch: &Batch, dropped: u64) {
        let Some(Some(channel)) = self.outlets.get_mut(batch.topic) else { return };
        (channel.decimated, channel.dropped) = (batch.decimated, batch.overwritten + dropped);
        let bytes = wire::seal(&channel.envelope(self.start_ns), &batch.bytes);
        channel.send(bytes, batch.samples, &self.last);
        let dropped = self.outlets.iter().flatten().map(|channel| channel.dropped).sum();
        self.shared.dropped.store(dropped, Ordering::Relaxed);
    }

    /// Takes away the signs of those who live no more, and gives one to those who do.
    fn see_who_lives(&mut self) -> Result<(), LinkError> {
        let living = self.shared.living();
        self.signs.retain(|(service, _)| living.contains(service));
        for service in living {
            if !self.signs.iter().any(|(one, _)| *one == service) {
                self.signs.push((service, self.link.sign(&keys::live(&self.shared.vehicle, service.name()))?));
            }
        }
        Ok(())
    }

    fn publish_report(&mut self) {
        let (queued, queue_max) = self.shared.queue.depth();
        let [swaps_asked, swaps_answered_here] = self.shared.swaps.counts();
        let topic = |(topic, channel): (&Topic, &Option<Channel>)| {
            let Channel { messages, samples, decimated, dropped, .. } = *channel.as_ref()?;
            Some(TopicReport { topic: topic.name().into(), messages, samples, decimated, dropped })
        };
        let report = GatewayReport {
            envelope: Some(self.report.envelope(self.start_ns)),
            queued: queued as u32,
            queue_max: queue_max as u32,
            refused: Some(*locked(&self.shared.refusals)),
            swaps_asked,
            swaps_answered_here,
            questions_turned_away: self.shared.turned_away.load(Ordering::Relaxed),
            topics: Topic::ALL.iter().zip(&self.outlets).filter_map(topic).collect(),
        };
        self.report.send(report.encoded(), 1, &self.last);
    }
}

impl Channel {
    fn open(link: &Link, key: String, message: String, output: Output) -> Result<Self, LinkError> {
        let outlet = link.outlet(&key, &message)?;
        Ok(Self { key, message, outlet, output, messages: 0, samples: 0, decimated: 0, dropped: 0 })
    }

    fn envelope(&self, start_ns: u64) -> Envelope {
        let Self { messages, samples, decimated, dropped, output: Output { frame, quaternion }, .. } = *self;
        let t_sent_ns = monotonic_ns();
        let counts = Envelope {
            sequence: messages,
            start_ns,
            samples_before: samples,
            decimated,
            dropped,
            t_sent_ns,
            ..Envelope::default()
        };
        counts.in_frame(frame, quaternion)
    }

    fn send(&mut self, bytes: Vec<u8>, samples: u64, last: &Last) {
        // A message that is not taken is missed by its number.
        let _ = self.outlet.send(&bytes);
        self.messages += 1;
        self.samples += samples;
        locked(last).insert(self.key.clone(), (self.message.clone(), bytes));
    }
}

/// The type of the messages under a topic's key.
fn batch_of(topic: Topic) -> String {
    messages::dispatch!(topic, M => batch_name::<M>())
}
