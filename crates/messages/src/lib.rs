//! What the services say to each other: fixed payloads, their names, units and layout fingerprints.
//!
//! Input, output: plain values without pointers, padding or invalid bit patterns, so that any bytes of the right length are a
//! message. Time: a message carries it, nothing here reads it. Failure: none; who reads a message checks what it means.
//!
//! | topic | type | from | to |
//! | --- | --- | --- | --- |
//! | `sensor` | [`SensorReading`] | an injector | ingest with source `bus` |
//! | `receiver` | [`ReceiverReading`] | an injector | ingest with source `bus` |
//! | `imu` | [`ImuSample`] | ingest | gyro, accel |
//! | `mag` | [`MagSample`] | ingest | fuser |
//! | `gnss` | [`GnssFix`] | ingest | fuser, course |
//! | `reference` | [`Reference`] | ingest, where the source knows the truth | supervisor |
//! | `gyro` | [`GyroStep`] | gyro | fuser |
//! | `accel` | [`AccelPoint`] | accel | fuser |
//! | `fused` | [`FusedState`] | fuser | course |
//! | `attitude` | [`AttitudeOutput`] | course | whoever asks |
//! | `credit` | [`Credit`] | supervisor | ingest |
//! | `checkpoint` | [`Checkpoint`] | every slot | supervisor |
//! | `difference` | [`Difference`] | a candidate | supervisor |
//! | `control` | [`Control`] | supervisor | every slot |
//! | `health` | [`Health`] | every service | supervisor |
#![forbid(unsafe_code)]

mod convert;
mod flags;
mod layout;
mod topics;

pub use convert::{finite, pair};
pub use flags::Flags;
pub use layout::{Field, Layout};
pub use topics::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Chart, Checkpoint, Control, CourseReference, Credit, Difference,
    FusedState, GnssFix, GyroStep, Header, Health, ImuSample, MagSample, ReceiverReading, Reference, SensorReading,
    State,
};

macro_rules! topics {
    ($($name:ident)*) => {
        /// Every topic, in the order of the table above.
        pub const TOPICS: &[&str] = &[$($name::TOPIC),*];

        /// The layout of every topic's payload.
        pub fn layouts() -> Vec<Layout> {
            vec![$($name::layout()),*]
        }

        /// Hands the payload's type of a topic to `visitor`; `None` where there is no such topic.
        pub fn with_type<V: Visitor>(topic: &str, visitor: V) -> Option<V::Output> {
            match topic {
                $($name::TOPIC => Some(visitor.visit::<$name>()),)*
                _ => None,
            }
        }
    };
}

topics! {
    SensorReading ReceiverReading ImuSample MagSample GnssFix Reference GyroStep AccelPoint FusedState AttitudeOutput
    Credit Checkpoint Difference Control Health
}

/// Topics with one message of every tick.
pub const EVERY_TICK: [&str; 5] =
    [ImuSample::TOPIC, GyroStep::TOPIC, AccelPoint::TOPIC, FusedState::TOPIC, AttitudeOutput::TOPIC];

/// What is to be done with the payload's type of a topic known by its name.
pub trait Visitor {
    /// What comes of it.
    type Output;
    /// Does it.
    fn visit<M: Message>(self) -> Self::Output;
}

/// A payload of a topic.
pub trait Message: bytemuck::Pod + core::fmt::Debug + Send + Sync {
    /// The topic's name.
    const TOPIC: &'static str;
    /// The type's name with its version; a change of meaning changes it.
    const TYPE: &'static str;

    /// Names, types and places of the fields.
    fn layout() -> Layout;
}

/// A message that descends from one IMU sample.
pub trait Ticked: Message {
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
        hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash
}

/// The hash of nothing.
pub const HASH_START: u64 = 0xcbf2_9ce4_8422_2325;
