//! One tick of the carried topics, as bytes.

use std::sync::LazyLock;

use graph::Presence;
use messages::{Flags, Header, Ticked};

/// A topic that can be carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// Which one it is.
    pub topic: graph::Topic,
    /// Its name.
    pub name: &'static str,
    /// Length of a message, bytes.
    pub size: usize,
    /// Of the layout of its messages.
    pub fingerprint: u64,
    /// It has a message of each tick.
    pub is_dense: bool,
    /// The flag of the ticks that it has a message of, if it has not one of each.
    pub flag: Flags,
}

/// The topics, in the order of [`graph::Topic::carried`]; their places there are the bits of [`Record::mask`].
pub static CARRIED_TOPICS: LazyLock<Vec<Topic>> = LazyLock::new(|| {
    let carried = graph::Topic::carried();
    let topics = carried
        .filter_map(|topic| messages::dispatch!(topic, ticked M => Some(described::<M>(topic)), other M => None));
    topics.take(TOPICS_MAX).collect()
});

/// Bits of a mask.
const TOPICS_MAX: usize = u8::BITS as usize;

fn described<M: Ticked>(topic: graph::Topic) -> Topic {
    let graph::Entry { name, presence, .. } = *M::TOPIC;
    let fingerprint = M::layout().fingerprint();
    Topic { topic, name, size: size_of::<M>(), fingerprint, is_dense: presence == Presence::EveryTick, flag: M::FLAG }
}

/// The place of a topic among those that can be carried.
pub fn place(name: &str) -> Option<usize> {
    CARRIED_TOPICS.iter().position(|carried| carried.name == name)
}

/// One tick: the message of every topic that has one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// The tick.
    pub tick: u64,
    /// Which topics have a message: the bit of each is its place in [`CARRIED_TOPICS`].
    pub mask: u8,
    /// The messages in that order, with nothing between.
    pub bytes: Vec<u8>,
}

impl Record {
    /// A tick without a message.
    pub fn empty(tick: u64) -> Self {
        Self { tick, mask: 0, bytes: Vec::new() }
    }

    /// Adds the message of a topic; those of earlier places must be there already.
    pub fn push(&mut self, place: usize, message: &[u8]) {
        self.mask |= 1 << place;
        self.bytes.extend_from_slice(message);
    }

    /// Each message with the place of its topic.
    pub fn messages(&self) -> impl Iterator<Item = (usize, &[u8])> {
        let mut rest = self.bytes.as_slice();
        places(self.mask).filter_map(move |(place, topic)| {
            let (message, after) = rest.split_at_checked(topic.size)?;
            rest = after;
            Some((place, message))
        })
    }
}

/// The topics of a mask, with their places.
pub fn places(mask: u8) -> impl Iterator<Item = (usize, &'static Topic)> {
    CARRIED_TOPICS.iter().enumerate().filter(move |(place, _)| mask & (1 << place) != 0)
}

/// The header that every carried message begins with.
pub fn header(message: &[u8]) -> Option<Header> {
    bytemuck::try_pod_read_unaligned(message.get(..size_of::<Header>())?).ok()
}
