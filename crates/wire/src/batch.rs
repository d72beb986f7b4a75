//! Batches of samples, named `<Message>Batch` in the schema. Counts in the envelope reveal losses.

use graph::Topic;
use prost::{
    Message as _,
    encoding::{self, DecodeContext, WireType},
};

use crate::{
    DecodeError, MAX_MESSAGE_BYTES, MAX_SAMPLES, Payload,
    error::{check_sample_count, check_size, malformed},
    v1::Envelope,
};

/// Field number of the envelope in every batch message.
const ENVELOPE_FIELD: u32 = 1;
/// Field number of the samples in every batch message.
const SAMPLES_FIELD: u32 = 2;
/// Maximum encoded size of an envelope, for six 64-bit numbers, two enums, tag and length.
const MAX_ENVELOPE_BYTES: usize = 74;

/// Returns the fully qualified name of a message's batch type in the schema.
pub fn batch_name<M: Payload>() -> String {
    format!("plumbline.v1.{}Batch", M::NAME)
}

/// Encodes samples as fields of a batch. [`encode_batch`] adds the envelope.
pub fn encode_samples<'m, M: Payload + 'm>(messages: impl IntoIterator<Item = &'m M>) -> Vec<u8> {
    let messages = messages.into_iter();
    // The capacity is estimated from the size on the bus, which is about the same as in protobuf.
    let mut bytes = Vec::with_capacity(messages.size_hint().0 * (size_of::<M>() + 16));
    messages.for_each(|message| encoding::message::encode(SAMPLES_FIELD, &message.to_proto(), &mut bytes));
    bytes
}

/// Encodes a batch from an envelope and samples encoded by [`encode_samples`].
///
/// The envelope may come before or after the samples, since protobuf fields have no fixed order.
pub fn encode_batch(envelope: &Envelope, samples: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(samples.len() + MAX_ENVELOPE_BYTES);
    encoding::message::encode(ENVELOPE_FIELD, envelope, &mut bytes);
    bytes.extend_from_slice(samples);
    bytes
}

/// Decodes and validates a batch from untrusted bytes.
///
/// # Errors
///
/// Returns an error if the bytes exceed [`MAX_MESSAGE_BYTES`], are not a batch of `M`, lack the
/// envelope, have more than [`MAX_SAMPLES`] samples, or contain an invalid sample.
pub fn decode_batch<M: Payload>(bytes: &[u8]) -> Result<(Envelope, Vec<M>), DecodeError> {
    check_size(bytes)?;
    let failed = malformed(M::NAME);
    let (mut envelope, mut samples, mut rest) = (None, Vec::new(), bytes);
    // Fields are decoded one by one, so that the number of samples is checked before they are
    // stored.
    while !rest.is_empty() {
        let (tag, wire_type) = encoding::decode_key(&mut rest).map_err(&failed)?;
        match tag {
            ENVELOPE_FIELD => {
                let envelope = envelope.get_or_insert_with(Envelope::default);
                encoding::message::merge(wire_type, envelope, &mut rest, DecodeContext::default()).map_err(&failed)?;
            }
            SAMPLES_FIELD => {
                let mut sample = M::Proto::default();
                encoding::message::merge(wire_type, &mut sample, &mut rest, DecodeContext::default())
                    .map_err(&failed)?;
                check_sample_count(M::NAME, samples.len() + 1)?;
                samples.push(M::from_proto(sample)?);
            }
            _ => skip_unknown_field(wire_type, tag, &mut rest).map_err(&failed)?,
        }
    }
    Ok((envelope.ok_or(DecodeError::Missing { field: "envelope" })?, samples))
}

/// Decodes a batch of samples of a topic. The samples are returned as concatenated bus messages.
///
/// # Errors
///
/// See [`decode_batch`].
pub fn decode_topic_batch(topic: Topic, bytes: &[u8]) -> Result<(Envelope, Vec<u8>), DecodeError> {
    messages::dispatch!(topic, M => decode_batch::<M>(bytes)
        .map(|(envelope, samples)| (envelope, bytemuck::cast_slice(&samples).to_vec())))
}

/// Skips a field that a later version of the schema may have added.
fn skip_unknown_field(wire_type: WireType, tag: u32, rest: &mut &[u8]) -> Result<(), prost::DecodeError> {
    encoding::skip_field(wire_type, tag, rest, DecodeContext::default())
}

/// Returns the number of messages to send in one batch. `message_bytes` is the encoded size of one
/// message.
///
/// A batch of this many messages takes up at most half of [`MAX_MESSAGE_BYTES`].
pub fn capacity(message_bytes: usize) -> usize {
    (MAX_MESSAGE_BYTES / 2 / message_bytes.max(1)).clamp(1, MAX_SAMPLES)
}

impl Envelope {
    /// Encodes the envelope as the first part of a message. Further fields can be appended.
    pub fn bytes(&self) -> Vec<u8> {
        self.encode_to_vec()
    }
}
