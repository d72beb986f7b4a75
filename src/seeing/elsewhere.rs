//! A vehicle that is looked at over the network, through its gateway.

use std::{
    cell::Cell,
    thread,
    time::{Duration, Instant},
};

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

use super::SeeError;
use crate::remote::{RemoteError, Way};

/// How long a vehicle is looked for once somebody is connected; its gateway reports what it sends once a second.
const FIND_LIMIT: Duration = Duration::from_secs(5);
/// Between two questions.
const ASK_INTERVAL: Duration = Duration::from_millis(100);
/// A vehicle that has been out of reach for so long is not waited for.
const REACH_LIMIT: Duration = Duration::from_secs(10);
/// Parcels taken at a look at most; what comes later comes at the next.
const MAX_PARCELS: usize = 4096;

/// Takes what became of messages, and one that came with its frame, as far as its sender says it; whether it wants more.
pub(crate) type TakeDelivered<'a> = dyn FnMut(Delivery, Option<(&[u8], Option<Output>)>) -> bool + 'a;

/// A vehicle that has been found.
pub(crate) struct Vehicle {
    name: String,
    link: Link,
    signs: MessageStream,
    /// The topics that it sends.
    topics: Vec<String>,
    /// Since when it has been out of reach.
    away: Cell<Option<Instant>>,
}

impl Vehicle {
    /// Looks for a vehicle and asks what it sends.
    pub(super) fn find(name: &str, way: &Way) -> Result<Self, SeeError> {
        Self::over(way.open()?, name)
    }

    /// The same over a link that there is.
    pub(crate) fn over(link: Link, name: &str) -> Result<Self, SeeError> {
        let signs = link.subscribe_liveliness(&keys::key(name, keys::LIVELINESS)).map_err(RemoteError::from)?;
        let deadline = Instant::now() + FIND_LIMIT;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let answers = link.query(&keys::key(name, keys::GATEWAY), Vec::new(), left.max(ASK_INTERVAL));
            let answers = answers.map_err(RemoteError::from)?;
            if let Some(report) = answers.iter().find_map(|(_, bytes)| GatewayReport::from_bytes(bytes).ok()) {
                let topics = report.topics.into_iter().map(|topic| topic.topic).collect();
                return Ok(Self { name: name.into(), link, signs, topics, away: Cell::new(None) });
            }
            if left.is_zero() {
                return Err(SeeError::NoVehicle { vehicle: name.into(), limit_s: FIND_LIMIT.as_secs_f64() });
            }
            thread::sleep(ASK_INTERVAL);
        }
    }

    /// The samples of a topic as they come in.
    pub(crate) fn crossing(&self, topic: Topic) -> Result<Crossing, SeeError> {
        if !self.topics.iter().any(|sent| sent == topic.name()) {
            let (vehicle, sent) = (self.name.clone(), self.topics.join(", "));
            return Err(SeeError::NotSent { vehicle, topic: topic.name().into(), sent });
        }
        let stream = self.link.subscribe(&keys::key(&self.name, topic.name())).map_err(RemoteError::from)?;
        Ok(Crossing { topic, stream, track: DeliveryTracker::default(), last: None, delivery: Delivery::default() })
    }

    /// It lives and the way to it is open, or it has not been long otherwise.
    pub(crate) fn is_in_reach(&self) -> bool {
        while let Some(sign) = self.signs.next(Duration::ZERO) {
            self.away.set((!sign.is_present).then(Instant::now));
        }
        self.away.get().is_none_or(|since| since.elapsed() < REACH_LIMIT)
    }

    /// What people are told then.
    pub(crate) fn out_of_reach(&self) -> String {
        format!("the vehicle {:?} has been out of reach for {:.0} s", self.name, REACH_LIMIT.as_secs_f64())
    }
}

/// A topic between the board and here.
pub(crate) struct Crossing {
    topic: Topic,
    stream: MessageStream,
    track: DeliveryTracker,
    last: Option<Envelope>,
    delivery: Delivery,
}

impl Crossing {
    /// Hands what has come to `take`, each message with its frame, as far as its sender says it, and with what became of the others on the way, as
    /// long as it wants any.
    pub(crate) fn look(&mut self, message_bytes: usize, take: &mut TakeDelivered<'_>) {
        for _ in 0..MAX_PARCELS {
            let Some(arrival) = self.stream.next(Duration::ZERO) else { return };
            let Ok((envelope, messages)) = wire::decode_topic_batch(self.topic, &arrival.bytes) else {
                self.delivery.refused += 1;
                take(self.delivery, None);
                continue;
            };
            let is_new = self.track.record(&envelope, (messages.len() / message_bytes) as u64);
            if is_new {
                self.delivery.bytes += arrival.bytes.len() as u64;
                self.count(&envelope);
            }
            let DeliveryTracker { samples: arrived, lost_samples: lost, repeated, restarts, .. } = self.track;
            self.delivery = Delivery { arrived, lost, repeated, restarts, ..self.delivery };
            take(self.delivery, None);
            let said = envelope.frame_and_order().map(|(frame, quaternion)| Output { frame, quaternion });
            let mut each = messages.chunks_exact(message_bytes);
            if is_new && !each.all(|message| take(self.delivery, Some((message, said)))) {
                return;
            }
        }
    }

    /// Counts what was left on board since the first message: the envelope's counts are since the gateway started.
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
