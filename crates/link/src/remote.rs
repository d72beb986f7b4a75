//! A vehicle seen from elsewhere.

use std::time::{Duration, Instant};

use wire::command::ControlMessage;
use zenoh::{
    Wait,
    handlers::{RingChannel, RingChannelHandler},
    pubsub::Subscriber,
    query::{ConsolidationMode, QueryTarget, ReplyError},
    sample::{Sample, SampleKind},
};

use crate::{Link, LinkError, at_key, outlet::REASON};

/// Messages that are kept for a reader who is slow; then the oldest are lost, and show as a gap.
const KEPT: usize = 4096;
/// Letters of a reason at most.
const REASON_MAX: usize = 4096;

/// Reads messages, newest wins.
#[derive(Debug)]
pub struct Stream(Subscriber<RingChannelHandler<Sample>>);

/// What has come.
#[derive(Debug, Clone)]
pub struct Arrival {
    /// Under which key.
    pub key: String,
    /// The message.
    pub bytes: Vec<u8>,
    /// Something came, or came to life; else it has gone.
    pub is_there: bool,
}

impl Link {
    /// Reads what is published under a key, or several.
    pub fn stream(&self, keys: &str) -> Result<Stream, LinkError> {
        let subscriber = self.session.declare_subscriber(keys.to_owned()).with(RingChannel::new(KEPT));
        subscriber.wait().map(Stream).map_err(at_key("reading", keys))
    }

    /// Sees what lives, and what comes and goes.
    pub fn signs(&self, keys: &str) -> Result<Stream, LinkError> {
        let liveliness = self.session.liveliness();
        let subscriber = liveliness.declare_subscriber(keys.to_owned()).history(true).with(RingChannel::new(KEPT));
        subscriber.wait().map(Stream).map_err(at_key("seeing what lives at", keys))
    }

    /// Every answer to a question within `limit`: its key and its bytes. Where there is none and somebody says why, that is the error.
    pub fn ask(&self, key: &str, payload: Vec<u8>, limit: Duration) -> Result<Vec<(String, Vec<u8>)>, LinkError> {
        let question = self.session.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None);
        let replies = question.payload(payload).timeout(limit).wait().map_err(at_key("asking", key))?;
        let deadline = Instant::now() + limit;
        let (mut answers, mut refused) = (Vec::new(), None);
        while let Ok(Some(reply)) = replies.recv_deadline(deadline) {
            match reply.result() {
                Ok(sample) => answers.push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())),
                Err(error) => refused = reason(error).or(refused),
            }
        }
        match refused {
            Some(reason) if answers.is_empty() => Err(LinkError::Refused { key: key.into(), reason }),
            _ => Ok(answers),
        }
    }

    /// The one answer to a question.
    pub fn ask_one<L: ControlMessage>(&self, key: &str, payload: Vec<u8>, limit: Duration) -> Result<L, LinkError> {
        let answers = self.ask(key, payload, limit)?;
        let unanswered = || LinkError::NoAnswer { key: key.into(), limit_s: limit.as_secs_f64() };
        let (_, bytes) = answers.into_iter().next().ok_or_else(unanswered)?;
        L::decoded(&bytes).map_err(|cause| LinkError::Answer { key: key.into(), cause })
    }
}

/// What whoever was asked says against it. Zenoh's own errors, such as that the time is over, are no text.
fn reason(error: &ReplyError) -> Option<String> {
    let said = (*error.encoding() == REASON).then(|| error.payload().to_bytes())?;
    let said = String::from_utf8_lossy(&said);
    Some(said.chars().filter(|letter| !letter.is_control() || *letter == '\n').take(REASON_MAX).collect())
}

impl Stream {
    /// What comes next within `limit`.
    pub fn next(&self, limit: Duration) -> Option<Arrival> {
        let sample = self.0.recv_timeout(limit).ok().flatten()?;
        Some(Arrival {
            key: sample.key_expr().to_string(),
            bytes: sample.payload().to_bytes().into_owned(),
            is_there: sample.kind() == SampleKind::Put,
        })
    }
}
