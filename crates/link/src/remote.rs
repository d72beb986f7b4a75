//! The remote side of the network, which subscribes to the messages of vehicles and sends queries.

use std::time::{Duration, Instant};

use foreign::ForeignText;
use wire::command::ControlMessage;
use zenoh::{
    Wait,
    handlers::{RingChannel, RingChannelHandler},
    pubsub::Subscriber,
    query::{ConsolidationMode, QueryTarget, ReplyError},
    sample::{Sample, SampleKind},
};

use crate::{Link, LinkError, at_key, publisher::REASON_ENCODING};

/// Maximum number of messages buffered for a slow reader. Beyond that, the oldest are dropped,
/// which shows as a gap.
const MAX_BUFFERED: usize = 4096;
/// Maximum number of responses to a query.
const MAX_RESPONSES: usize = 1024;
/// Maximum length of the reason for a rejection, characters.
const MAX_REASON_CHARS: usize = 4096;

/// Stream of messages. If the buffer is full, the oldest are dropped.
#[derive(Debug)]
pub struct MessageStream(Subscriber<RingChannelHandler<Sample>>);

/// Message or liveliness change received from the network.
#[derive(Debug, Clone)]
pub struct RemoteMessage {
    /// Key of the message.
    pub key: String,
    /// Payload of the message.
    pub bytes: Vec<u8>,
    /// `true` for a message or a new liveliness token, `false` for a withdrawn token.
    pub is_present: bool,
}

impl Link {
    /// Subscribes to the messages under one or more keys.
    pub fn subscribe(&self, keys: &str) -> Result<MessageStream, LinkError> {
        let subscriber = self.session.declare_subscriber(keys.to_owned()).with(RingChannel::new(MAX_BUFFERED));
        subscriber.wait().map(MessageStream).map_err(at_key("subscribing to", keys))
    }

    /// Subscribes to liveliness. The stream starts with the existing tokens, followed by all
    /// changes.
    pub fn subscribe_liveliness(&self, keys: &str) -> Result<MessageStream, LinkError> {
        let liveliness = self.session.liveliness();
        let subscriber =
            liveliness.declare_subscriber(keys.to_owned()).history(true).with(RingChannel::new(MAX_BUFFERED));
        subscriber.wait().map(MessageStream).map_err(at_key("subscribing to liveliness at", keys))
    }

    /// Returns the key and bytes of the responses to a query that arrive within `limit`, at most
    /// 1024 of them.
    ///
    /// # Errors
    ///
    /// Fails if the query cannot be sent, or if it was rejected and has no other response.
    pub fn query(&self, key: &str, payload: Vec<u8>, limit: Duration) -> Result<Vec<(String, Vec<u8>)>, LinkError> {
        let query = self.session.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None);
        let replies = query.payload(payload).timeout(limit).wait().map_err(at_key("querying", key))?;
        let deadline = Instant::now() + limit;
        let (mut responses, mut rejection) = (Vec::new(), None);
        while responses.len() < MAX_RESPONSES
            && let Ok(Some(reply)) = replies.recv_deadline(deadline)
        {
            match reply.result() {
                Ok(sample) => responses.push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())),
                Err(error) => rejection = reason(error).or(rejection),
            }
        }
        match rejection {
            Some(reason) if responses.is_empty() => Err(LinkError::Rejected { key: key.into(), reason }),
            _ => Ok(responses),
        }
    }

    /// Returns the first response to a query, decoded.
    ///
    /// # Errors
    ///
    /// Fails if no response arrives within `limit`, the response is invalid or the query was
    /// rejected.
    pub fn query_one<L: ControlMessage>(&self, key: &str, payload: Vec<u8>, limit: Duration) -> Result<L, LinkError> {
        let responses = self.query(key, payload, limit)?;
        let no_response = || LinkError::NoResponse { key: key.into(), limit_s: limit.as_secs_f64() };
        let (_, bytes) = responses.into_iter().next().ok_or_else(no_response)?;
        L::from_bytes(&bytes).map_err(|cause| LinkError::InvalidResponse { key: key.into(), cause })
    }
}

/// Returns the reason for a rejection. Zenoh's own errors, such as a timeout, have another encoding
/// and yield `None`.
fn reason(error: &ReplyError) -> Option<ForeignText> {
    let text = (*error.encoding() == REASON_ENCODING).then(|| error.payload().to_bytes())?;
    let text = String::from_utf8_lossy(&text);
    Some(text.chars().take(MAX_REASON_CHARS).collect::<String>().into())
}

impl MessageStream {
    /// Discards the messages received so far.
    pub fn discard_received(&self) {
        for _ in 0..MAX_BUFFERED {
            let Ok(Some(_)) = self.0.try_recv() else { break };
        }
    }

    /// Returns the next message, or `None` if no message arrives within `limit`.
    pub fn next(&self, limit: Duration) -> Option<RemoteMessage> {
        let sample = self.0.recv_timeout(limit).ok().flatten()?;
        Some(RemoteMessage {
            key: sample.key_expr().to_string(),
            bytes: sample.payload().to_bytes().into_owned(),
            is_present: sample.kind() == SampleKind::Put,
        })
    }
}
