//! Messages of the bus: fixed-size payloads with their names, units and layout fingerprints.
//!
//! Input, output: plain values without pointers, padding or invalid bit patterns. Any bytes of the
//! right length are a valid message.
//!
//! Time: messages contain timestamps, but no clock is read here.
//!
//! Failure: no operation fails. Subscribers validate the contents of messages.
//!
//! The table of [`graph`] defines the payload, publisher and subscribers of each topic.
//! [`dispatch!`] maps a topic to its payload type.
#![forbid(unsafe_code)]

mod binding;
mod layout;
mod payloads;

#[doc(hidden)]
pub use graph;

use graph::{Entry, Topic};

pub use attitude::flags::Flags;
pub use layout::{Field, Layout};
pub use payloads::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Chart, Checkpoint, Control, CourseReference, Credit, Difference,
    EventKind, FusedState, GnssFix, GyroStep, Header, Health, ImuSample, MagSample, ReceiverReading, Reference,
    SensorReading, State, SystemEvent, TakenReading,
};

/// Returns the payload layouts of all topics, in the order of the table.
pub fn layouts() -> Vec<Layout> {
    Topic::ALL.iter().map(|topic| layout(*topic)).collect()
}

/// Returns the payload layout of a topic.
pub fn layout(topic: Topic) -> Layout {
    dispatch!(topic, M => M::layout())
}

/// Returns the payload size of a topic, bytes.
pub fn size(topic: Topic) -> usize {
    dispatch!(topic, M => size_of::<M>())
}

/// Payload of a topic.
pub trait Message: bytemuck::Pod + core::fmt::Debug + Send + Sync {
    /// Table entry of the topic that carries the payload.
    const TOPIC: &'static Entry;
    /// Type name, including a version that is incremented when the meaning of the payload changes.
    const TYPE: &'static str;

    /// Returns the names, types and offsets of the fields.
    fn layout() -> Layout;

    /// Returns the time of the message in ns on the source's clock, or `None` if it has no such
    /// time.
    fn source_time_ns(&self) -> Option<i64> {
        None
    }
}

/// Message derived from one IMU sample.
pub trait Ticked: Message {
    /// Flag that is set in ticks with such a message; [`Flags::NONE`] if every tick has one.
    const FLAG: Flags;

    /// Returns the header with the tick, interval and flags.
    fn header(&self) -> &Header;
    /// Returns a mutable reference to the header.
    fn header_mut(&mut self) -> &mut Header;

    /// Returns the message without its run-specific fields.
    ///
    /// Monotonic timestamps, epoch and incarnation are zeroed. The remaining bytes are the same in
    /// every run with the same input.
    fn canonical(mut self) -> Self {
        let header = self.header_mut();
        (header.t_born_ns, header.t_sent_ns) = (0, 0);
        (header.epoch, header.incarnation) = (0, 0);
        self
    }
}

/// Continues a 64-bit FNV-1a hash over `bytes`. A new hash starts with [`HASH_START`].
pub fn hash(mut hash: u64, bytes: &[u8]) -> u64 {
    for byte in bytes {
        hash = (hash ^ u64::from(*byte)).wrapping_mul(HASH_PRIME);
    }
    hash
}

/// Continues a 64-bit hash over `words`. It is several times faster than [`hash()`], and yields
/// other values. A new hash starts with [`HASH_START`].
pub fn hash_words(hash: u64, words: &[u64]) -> u64 {
    words.iter().fold(hash, |hash, word| {
        let hash = (hash ^ word).wrapping_mul(HASH_PRIME);
        // Without this shift, changes in the highest bits of two words could cancel each other.
        hash ^ (hash >> 32)
    })
}

/// Initial value of [`hash()`] and [`hash_words`].
pub const HASH_START: u64 = 0xcbf2_9ce4_8422_2325;
const HASH_PRIME: u64 = 0x0000_0100_0000_01b3;
