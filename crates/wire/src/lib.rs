//! Protobuf encoding of the messages that leave the board, and the Zenoh keys they are sent under.
//!
//! Input: messages of the topics, or untrusted bytes.
//!
//! Output: bytes, or validated messages.
//!
//! Failure: invalid bytes are rejected with a [`DecodeError`], which can be counted by kind. No
//! input causes a panic. Memory use is bounded by a small multiple of [`MAX_MESSAGE_BYTES`].
//!
//! The schema is in `proto/plumbline/v1/*.proto`, the schema of third-party viewers in
//! `proto/foxglove/*.proto`. Only this crate depends on prost. A test generates `src/generated`
//! from the schemas: after a change in `proto`, run `cargo test -p wire generated` before using the
//! new fields.
//!
//! | module | contents |
//! | --- | --- |
//! | [`payload`] | conversion between topic messages and protobuf |
//! | [`batch`] | samples in an envelope whose counts reveal losses |
//! | [`delivery`] | loss accounting of a subscriber |
//! | `frame` | coordinate frame of the samples in an envelope |
//! | [`measurement`] | measurements sent by a program to a `protobuf` source |
//! | [`command`] | requests to a running system, and their responses |
//! | [`cockpit`] | messages exchanged with the cockpit page |
//! | [`keys`] | Zenoh keys |
//! | [`error`] | decode errors and their counts |
//! | [`schema`] | descriptors of the schema, for clients without the `.proto` files |
//! | [`viewer`] | attitude and position in the schemas of third-party viewers |
//! | [`channel`] | topics as channels of flight recordings and viewers |
#![forbid(unsafe_code)]

pub mod batch;
pub mod channel;
pub mod cockpit;
pub mod command;
pub mod delivery;
pub mod error;
mod field;
mod frame;
pub mod keys;
pub mod measurement;
pub mod payload;
pub mod schema;
pub mod viewer;

/// Generated types of `proto/plumbline/v1`. They are documented in the schemas.
#[allow(missing_docs, unreachable_pub, clippy::all, reason = "generated")]
pub mod v1 {
    include!("generated/plumbline.v1.rs");
}

pub use batch::{decode_batch, decode_topic_batch, encode_batch, encode_samples};
pub use error::{DecodeError, DecodeErrorCounts};
pub use payload::Payload;

/// Maximum size of a message, bytes. It is more than twice the size of the largest message that is
/// sent, a batch of checkpoints.
pub const MAX_MESSAGE_BYTES: usize = 64 * 1024;
/// Maximum number of samples in a batch.
pub const MAX_SAMPLES: usize = 256;
