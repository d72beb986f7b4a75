//! Publishes to the network: liveliness tokens, the gateway's report, and messages in envelopes.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use graph::Topic;
use launch::{Launch, Output, Service};
use link::{Link, LinkError, Liveliness, MessagePublisher};
use runtime::clock::monotonic_ns;
use wire::{
    batch::batch_name,
    command::ControlMessage,
    keys,
    v1::{Envelope, GatewayReport, TopicReport},
};

use crate::{
    locked::locked,
    queue::{Batch, MAX_QUEUED_BATCHES},
    shared::Shared,
};

/// Interval between updates of the liveliness tokens.
pub(crate) const LIVELINESS_INTERVAL: Duration = Duration::from_millis(100);
/// Interval between two reports of the gateway.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Last message sent under each key, with its type.
pub(crate) type LastMessages = Arc<Mutex<BTreeMap<String, (String, Vec<u8>)>>>;

/// Publisher that sends the queued batches to the network.
pub(crate) struct NetworkPublisher {
    link: Link,
    shared: Arc<Shared>,
    channels: Vec<Option<KeyChannel>>,
    report: KeyChannel,
    start_ns: u64,
    last: LastMessages,
    service_tokens: Vec<(Service, Liveliness)>,
    _vehicle_token: Liveliness,
    liveliness_updated: Instant,
    reported: Instant,
}

/// Publisher for one key, with its counts.
struct KeyChannel {
    key: String,
    message: String,
    outlet: MessagePublisher,
    /// Frame and quaternion order of the samples.
    output: Output,
    messages: u64,
    samples: u64,
    decimated: u64,
    dropped: u64,
}

impl NetworkPublisher {
    pub(crate) fn open(link: &Link, shared: Arc<Shared>, launch: &Launch, start_ns: u64) -> Result<Self, LinkError> {
        let vehicle = shared.vehicle.clone();
        let channel = |topic: &str, message: String| {
            let output = if topic == Topic::Attitude.name() { launch.output } else { Output::default() };
            KeyChannel::open(link, keys::key(&vehicle, topic), message, output)
        };
        let rates = &launch.gateway.rates;
        let channels = Topic::ALL.iter().map(|topic| {
            rates.contains_key(topic.name()).then(|| channel(topic.name(), batch_type(*topic))).transpose()
        });
        Ok(Self {
            channels: channels.collect::<Result<_, _>>()?,
            report: channel(keys::GATEWAY, format!("plumbline.v1.{}", GatewayReport::NAME))?,
            start_ns,
            last: LastMessages::default(),
            service_tokens: Vec::new(),
            _vehicle_token: link.declare_liveliness(&keys::key(&vehicle, keys::LIVELINESS))?,
            link: link.clone(),
            shared,
            liveliness_updated: Instant::now(),
            reported: Instant::now(),
        })
    }

    /// Returns the map with the last message sent under each key. The publisher keeps the map up to
    /// date.
    pub(crate) fn last(&self) -> LastMessages {
        self.last.clone()
    }

    /// Sends the batches in the queue.
    pub(crate) fn send_queued(&mut self) {
        for _ in 0..MAX_QUEUED_BATCHES {
            let Some((batch, dropped)) = self.shared.queue.pop() else { break };
            self.send(&batch, dropped);
        }
    }

    /// Sends the queued batches. Also updates the liveliness tokens and sends the report when these
    /// are due.
    pub(crate) fn poll(&mut self) -> Result<(), LinkError> {
        self.send_queued();
        if self.liveliness_updated.elapsed() > LIVELINESS_INTERVAL {
            self.liveliness_updated = Instant::now();
            self.update_liveliness()?;
        }
        if self.reported.elapsed() > REPORT_INTERVAL {
            self.reported = Instant::now();
            self.send_report();
        }
        Ok(())
    }

    fn send(&mut self, batch: &Batch, dropped: u64) {
        let Some(Some(channel)) = self.channels.get_mut(batch.topic_index) else { return };
        (channel.decimated, channel.dropped) = (batch.decimated, batch.overwritten + dropped);
        let bytes = wire::encode_batch(&channel.envelope(self.start_ns), &batch.bytes);
        channel.send(bytes, batch.samples, &self.last);
        let dropped = self.channels.iter().flatten().map(|channel| channel.dropped).sum();
        self.shared.dropped.store(dropped, Ordering::Relaxed);
    }

    /// Declares liveliness tokens for the live services and withdraws the tokens of all others.
    fn update_liveliness(&mut self) -> Result<(), LinkError> {
        let live = self.shared.live_services();
        self.service_tokens.retain(|(service, _)| live.contains(service));
        for service in live {
            if !self.service_tokens.iter().any(|(known, _)| *known == service) {
                self.service_tokens.push((
                    service,
                    self.link.declare_liveliness(&keys::service_liveliness(&self.shared.vehicle, service.name()))?,
                ));
            }
        }
        Ok(())
    }

    fn send_report(&mut self) {
        let (queued, queue_max) = self.shared.queue.depth();
        let [swaps_requested, swaps_answered_locally] = self.shared.swaps.counts();
        let topic = |(topic, channel): (&Topic, &Option<KeyChannel>)| {
            let KeyChannel { messages, samples, decimated, dropped, .. } = *channel.as_ref()?;
            Some(TopicReport { topic: topic.name().into(), messages, samples, decimated, dropped })
        };
        let report = GatewayReport {
            envelope: Some(self.report.envelope(self.start_ns)),
            queued: queued as u32,
            queue_max: queue_max as u32,
            refused: Some(*locked(&self.shared.decode_errors)),
            swaps_requested,
            swaps_answered_locally,
            queries_rejected: self.shared.rejected_queries.load(Ordering::Relaxed),
            topics: Topic::ALL.iter().zip(&self.channels).filter_map(topic).collect(),
        };
        self.report.send(report.to_bytes(), 1, &self.last);
    }
}

impl KeyChannel {
    fn open(link: &Link, key: String, message: String, output: Output) -> Result<Self, LinkError> {
        let outlet = link.publisher(&key, &message)?;
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
        counts.with_frame(frame, quaternion)
    }

    fn send(&mut self, bytes: Vec<u8>, samples: u64, last: &LastMessages) {
        // A message that could not be sent is visible as a gap in the sequence.
        let _ = self.outlet.send(&bytes);
        self.messages += 1;
        self.samples += samples;
        locked(last).insert(self.key.clone(), (self.message.clone(), bytes));
    }
}

/// Returns the type of the messages sent under a topic's key.
fn batch_type(topic: Topic) -> String {
    messages::dispatch!(topic, M => batch_name::<M>())
}
