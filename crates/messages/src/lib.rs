//! What the services say to each other: fixed payloads, their names, units and layout fingerprints.
//!
//! Input, output: plain values without pointers, padding or invalid bit patterns, so that any bytes of the right length are a
//! message. Time: a message carries it, nothing here reads it. Failure: none; who reads a message checks what it means.
//!
//! Which topic carries which payload, and from whom to whom, is the table of [`graph`]; [`dispatch!`] goes from a topic to its payload's type.
#![forbid(unsafe_code)]

mod binding;
mod flags;
mod layout;
mod payloads;

#[doc(hidden)]
pub use graph;

use graph::{Entry, Topic};

pub use flags::Flags;
pub use layout::{Field, Layout};
pub use payloads::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Chart, Checkpoint, Control, CourseReference, Credit, Difference,
    EventKind, FusedState, GnssFix, GyroStep, Header, Health, ImuSample, MagSample, ReceiverReading, Reference,
    SensorReading, State, SystemEvent, TakenReading,
};

/// The layout of every topic's payload, in the order of the table.
pub fn layouts() -> Vec<Layout> {
    Topic::ALL.iter().map(|topic| layout(*topic)).collect()
}

/// The layout of a topic's payload.
pub fn layout(topic: Topic) -> Layout {
    dispatch!(topic, M => M::layout())
}

/// The length of a topic's payload, bytes.
pub fn size(topic: Topic) -> usize {
    dispatch!(topic, M => size_of::<M>())
}

/// A payload of a topic.
pub trait Message: bytemuck::Pod + core::fmt::Debug + Send + Sync {
    /// What the table says of the topic that carries it.
    const TOPIC: &'static Entry;
    /// The type's name with its version; a change of meaning changes it.
    const TYPE: &'static str;

    /// Names, types and places of the fields.
    fn layout() -> Layout;

    /// Of when it is on the source's clock, ns, where it says so; ticks come `rate_hz` times a second.
    fn source_time_ns(&self, _rate_hz: f64) -> Option<i64> {
        None
    }
}

/// A message that descends from one IMU sample.
pub trait Ticked: Message {
    /// The flag of the ticks that have one; none where every tick has.
    const FLAG: Flags;

    /// Where it comes from.
    fn header(&self) -> &Header;
    /// Where it comes from.
    fn header_mut(&mut self) -> &mut Header;

    /// The bytes that are the same in every run on the same input: those of the message without its stamps of this run's clock,
    /// decisions and processes.
    fn canonical(mut self) -> Self {
        let header = self.header_mut();
        (header.t_born_ns, header.t_sent_ns) = (0, 0);
        (header.epoch, header.incarnation) = (0, 0);
        self
    }
}

/// FNV-1a, 64 bits, continued from `hash`; start with [`HASH_START`].
pub fn hash(mut hash: u64, bytes: &[u8]) -> u64 {
    for byte in bytes {
        hash = (hash ^ u64::from(*byte)).wrapping_mul(HASH_PRIME);
    }
    hash
}

/// The hash of nothing.
pub const HASH_START: u64 = 0xcbf2_9ce4_8422_2325;
const HASH_PRIME: u64 = 0x0000_0100_0000_01b3;
