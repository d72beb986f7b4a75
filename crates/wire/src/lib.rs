//! The messages beyond the board: protobuf, and the keys under which it goes over the network.
//!
//! Input: messages of the topics, or bytes from anywhere. Output: bytes, or checked messages. Time: none. Failure: bytes that are no
//! message are refused with what is wrong with them, and counted by kind; nothing here panics or takes memory beyond
//! [`BYTES_MAX`] times a small factor, whatever the bytes are.
//!
//! The schema is `proto/plumbline/v1/*.proto`, that of viewers `proto/foxglove/*.proto`; this is the only crate that names prost.
//! `src/generated` is made of them by a test: after a change in `proto`, `cargo test -p wire generated` first, then whoever uses the new field.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`payload`] | a topic's message as protobuf, and back |
//! | [`batch`] | samples in an envelope by which a loss is proved |
//! | `frame` | in which frame samples are |
//! | [`measurement`] | what a program sends that has sensors |
//! | [`command`] | what a running system can be asked |
//! | [`cockpit`] | what the cockpit's page is told and asks for |
//! | [`keys`] | where everything is found |
//! | [`refusal`] | why bytes are no message |
//! | [`schema`] | the descriptors, for whoever has no copy of the files |
//! | [`viewer`] | the attitude in the schemas that viewers know |
//! | [`channel`] | topics as channels of flights and viewers |
#![forbid(unsafe_code)]

pub mod batch;
pub mod channel;
pub mod cockpit;
pub mod command;
pub mod delivery;
mod field;
mod frame;
pub mod keys;
pub mod measurement;
pub mod payload;
pub mod refusal;
pub mod schema;
pub mod viewer;

/// The types of `proto/plumbline/v1`, as generated; the schemas say what they mean.
#[allow(missing_docs, unreachable_pub, clippy::all, reason = "generated")]
pub mod v1 {
    include!("generated/plumbline.v1.rs");
}

pub use batch::{open, open_topic, samples, seal};
pub use payload::Payload;
pub use refusal::{Refusal, Refusals};

/// Bytes of a message at most; the largest that is sent, a batch of checkpoints, has less than half.
pub const BYTES_MAX: usize = 64 * 1024;
/// Samples in a message at most.
pub const SAMPLES_MAX: usize = 256;
