//! Messages of one tick on the carried topics, as bytes.

use std::sync::LazyLock;

use graph::Presence;
use messages::{Flags, Header, Ticked};

/// Topic that can be carried to another host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CarriedTopic {
    /// Topic of the bus.
    pub topic: graph::Topic,
    /// Name of the topic.
    pub name: &'static str,
    /// Size of a message in bytes.
    pub size: usize,
    /// Fingerprint of the message layout.
    pub fingerprint: u64,
    /// `true` if every tick has a message.
    pub is_dense: bool,
    /// Header flag that marks the ticks for which the topic has a message; empty for a dense topic.
    pub flag: Flags,
}

/// Topics in the order of [`graph::Topic::carried`]. Their indices are the bits of
/// [`Record::mask`].
pub static CARRIED_TOPICS: LazyLock<Vec<CarriedTopic>> = LazyLock::new(|| {
    let carried = graph::Topic::carried();
    let topics =
        carried.filter_map(|topic| messages::dispatch!(topic, ticked M => Some(describe::<M>(topic)), other M => None));
    topics.take(MAX_TOPICS).collect()
});

/// Maximum number of topics, limited by the number of bits in a mask.
const MAX_TOPICS: usize = u8::BITS as usize;

fn describe<M: Ticked>(topic: graph::Topic) -> CarriedTopic {
    let graph::Entry { name, presence, .. } = *M::TOPIC;
    let fingerprint = M::layout().fingerprint();
    CarriedTopic {
        topic,
        name,
        size: size_of::<M>(),
        fingerprint,
        is_dense: presence == Presence::EveryTick,
        flag: M::FLAG,
    }
}

/// Returns the index of a topic in [`CARRIED_TOPICS`], or `None` if it cannot be carried.
pub fn index_of(name: &str) -> Option<usize> {
    CARRIED_TOPICS.iter().position(|topic| topic.name == name)
}

/// Messages of one tick on the carried topics.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Tick of the messages.
    pub tick: u64,
    /// Topics that have a message, one bit for each index in [`CARRIED_TOPICS`].
    pub mask: u8,
    /// Concatenated messages in the order of the topics.
    pub bytes: Vec<u8>,
}

impl Record {
    /// Creates a record without messages.
    pub fn new(tick: u64) -> Self {
        Self { tick, mask: 0, bytes: Vec::new() }
    }

    /// Appends the message of a topic. Messages must be appended in the order of the topics.
    pub fn push(&mut self, index: usize, message: &[u8]) {
        self.mask |= 1 << index;
        self.bytes.extend_from_slice(message);
    }

    /// Returns the messages with the indices of their topics.
    pub fn messages(&self) -> impl Iterator<Item = (usize, &[u8])> {
        let mut rest = self.bytes.as_slice();
        topics_in(self.mask).filter_map(move |(index, topic)| {
            let (message, after) = rest.split_at_checked(topic.size)?;
            rest = after;
            Some((index, message))
        })
    }
}

/// Returns the topics of a mask with their indices.
pub fn topics_in(mask: u8) -> impl Iterator<Item = (usize, &'static CarriedTopic)> {
    CARRIED_TOPICS.iter().enumerate().filter(move |(index, _)| mask & (1 << index) != 0)
}

/// Reads the header at the start of a carried message. Returns `None` if the message is too short.
pub fn message_header(message: &[u8]) -> Option<Header> {
    bytemuck::try_pod_read_unaligned(message.get(..size_of::<Header>())?).ok()
}
