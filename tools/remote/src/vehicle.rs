//! Topics of a remote vehicle, received through its gateway.

use std::{
    cell::Cell,
    thread,
    time::{Duration, Instant},
};

use foreign::ForeignText;
use graph::Topic;
use launch::Output;
use link::{Link, MessageStream};
use observe::flow::Delivery;
use wire::{
    command::ControlMessage,
    delivery::DeliveryTracker,
    keys,
    v1::{Envelope, GatewayReport},
};

use crate::error::RemoteError;

/// Timeout for finding a vehicle once connected. A gateway reports its topics once a second.
const FIND_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval between two queries to a vehicle while it is being found.
const QUERY_INTERVAL: Duration = Duration::from_millis(100);
/// Time after which an unreachable vehicle is given up.
const UNREACHABLE_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum number of batches received in one poll. The remaining ones are received in the next
/// poll.
const MAX_BATCHES: usize = 4096;
/// Maximum number of changes of liveliness that are processed per check, so that the caller is not
/// starved.
const MAX_TOKENS: usize = 1000;

/// Callback for delivery statistics and, if present, a message with the frame that its publisher
/// reported. Returns `false` to stop.
pub type OnDelivery<'a> = dyn FnMut(Delivery, Option<(&[u8], Option<Output>)>) -> bool + 'a;

/// Vehicle that was found on the network.
pub struct RemoteVehicle {
    name: String,
    link: Link,
    liveliness: MessageStream,
    /// Names of the topics that the vehicle publishes.
    topics: Vec<ForeignText>,
    /// Time at which the vehicle became unreachable; `None` while it is reachable.
    unreachable_since: Cell<Option<Instant>>,
}

impl RemoteVehicle {
    /// Finds the vehicle over an open link.
    ///
    /// # Errors
    ///
    /// Fails if the vehicle does not reply before a timeout.
    pub fn find(link: Link, name: &str) -> Result<Self, RemoteError> {
        let liveliness = link.subscribe_liveliness(&keys::key(name, keys::LIVELINESS))?;
        let deadline = Instant::now() + FIND_TIMEOUT;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let replies = link.query(&keys::key(name, keys::GATEWAY), Vec::new(), left.max(QUERY_INTERVAL))?;
            if let Some(report) = replies.iter().find_map(|(_, bytes)| GatewayReport::from_bytes(bytes).ok()) {
                let topics = report.topics.into_iter().map(|topic| topic.topic.into()).collect();
                return Ok(Self { name: name.into(), link, liveliness, topics, unreachable_since: Cell::new(None) });
            }
            if left.is_zero() {
                return Err(RemoteError::NoVehicle { vehicle: name.into(), limit_s: FIND_TIMEOUT.as_secs_f64() });
            }
            thread::sleep(QUERY_INTERVAL);
        }
    }

    /// Returns `true` if the vehicle publishes the topic.
    pub fn publishes(&self, topic: Topic) -> bool {
        self.topics.iter().any(|sent| *sent == *topic.name())
    }

    /// Subscribes to a topic.
    ///
    /// # Errors
    ///
    /// Fails if the vehicle does not publish the topic.
    pub fn subscribe(&self, topic: Topic) -> Result<RemoteTopic, RemoteError> {
        if !self.publishes(topic) {
            let (vehicle, sent) = (self.name.clone(), foreign::list(&self.topics));
            return Err(RemoteError::NotSent { vehicle, topic: topic.name().into(), sent });
        }
        let stream = self.link.subscribe(&keys::key(&self.name, topic.name()))?;
        Ok(RemoteTopic {
            topic,
            stream,
            tracker: DeliveryTracker::default(),
            last: None,
            delivery: Delivery::default(),
        })
    }

    /// Returns `true` if the vehicle is alive or has been unreachable only briefly.
    pub fn is_reachable(&self) -> bool {
        for _ in 0..MAX_TOKENS {
            let Some(token) = self.liveliness.next(Duration::ZERO) else { break };
            self.unreachable_since.set((!token.is_present).then(Instant::now));
        }
        self.unreachable_since.get().is_none_or(|since| since.elapsed() < UNREACHABLE_TIMEOUT)
    }

    /// Returns the message that is printed when the program stops waiting for the vehicle.
    pub fn unreachable_message(&self) -> String {
        format!("vehicle {:?} has been unreachable for {:.0} s", self.name, UNREACHABLE_TIMEOUT.as_secs_f64())
    }
}

/// Topic of a remote vehicle.
pub struct RemoteTopic {
    topic: Topic,
    stream: MessageStream,
    tracker: DeliveryTracker,
    last: Option<Envelope>,
    delivery: Delivery,
}

impl RemoteTopic {
    /// Receives all available batches.
    ///
    /// Passes the delivery statistics and each message, with the frame that its publisher reported,
    /// to `on_delivery` until it returns `false`.
    pub fn poll(&mut self, message_bytes: usize, on_delivery: &mut OnDelivery<'_>) {
        for _ in 0..MAX_BATCHES {
            let Some(arrival) = self.stream.next(Duration::ZERO) else { return };
            let Ok((envelope, messages)) = wire::decode_topic_batch(self.topic, &arrival.bytes) else {
                self.delivery.rejected += 1;
                on_delivery(self.delivery, None);
                continue;
            };
            let is_new = self.tracker.record(&envelope, (messages.len() / message_bytes) as u64);
            if is_new {
                self.delivery.bytes += arrival.bytes.len() as u64;
                self.count(&envelope);
            }
            let DeliveryTracker { samples: arrived, lost_samples: lost, repeated, restarts, .. } = self.tracker;
            self.delivery = Delivery { received: arrived, lost, repeated, restarts, ..self.delivery };
            on_delivery(self.delivery, None);
            let reported = envelope.frame_and_order().map(|(frame, quaternion)| Output { frame, quaternion });
            let mut each = messages.chunks_exact(message_bytes);
            if is_new && !each.all(|message| on_delivery(self.delivery, Some((message, reported)))) {
                return;
            }
        }
    }

    /// Updates the counts of samples that the gateway has omitted or dropped since the first
    /// received batch. Differences are added, because the counts in the envelope begin when the
    /// gateway starts.
    fn count(&mut self, envelope: &Envelope) {
        let before = match &self.last {
            None => envelope,
            Some(last) if last.start_ns == envelope.start_ns => last,
            Some(_) => &Envelope::default(),
        };
        self.delivery.decimated += envelope.decimated.saturating_sub(before.decimated);
        self.delivery.dropped += envelope.dropped.saturating_sub(before.dropped);
        self.last = Some(*envelope);
    }
}
