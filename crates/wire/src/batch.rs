//! Samples in an envelope by which a loss is proved: `<Message>Batch` of the schema, whatever the message.

use graph::Topic;
use prost::{
    Message as _,
    encoding::{self, DecodeContext, WireType},
};

use crate::{
    BYTES_MAX, Payload, Refusal, SAMPLES_MAX,
    refusal::{malformed, within_samples, within_size},
    v1::Envelope,
};

/// The fields of every batch.
const ENVELOPE: u32 = 1;
const SAMPLES: u32 = 2;
/// Of an envelope at most: six numbers of 64 bits, two names, its tag and its length.
const ENVELOPE_BYTES: usize = 74;

/// The name of a message's batch in the schema, with its package.
pub fn batch_name<M: Payload>() -> String {
    format!("plumbline.v1.{}Batch", M::NAME)
}

/// Samples as they stand in a batch; [`seal`] puts the envelope to them.
pub fn samples<'m, M: Payload + 'm>(messages: impl IntoIterator<Item = &'m M>) -> Vec<u8> {
    let messages = messages.into_iter();
    // A message on the wire is about as long as on the bus.
    let mut bytes = Vec::with_capacity(messages.size_hint().0 * (size_of::<M>() + 16));
    messages.for_each(|message| encoding::message::encode(SAMPLES, &message.form(), &mut bytes));
    bytes
}

/// A batch: the envelope and the samples. The order of a message's fields is of no consequence.
pub fn seal(envelope: &Envelope, samples: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(samples.len() + ENVELOPE_BYTES);
    encoding::message::encode(ENVELOPE, envelope, &mut bytes);
    bytes.extend_from_slice(samples);
    bytes
}

/// The envelope and the samples of bytes from anywhere, checked.
pub fn open<M: Payload>(bytes: &[u8]) -> Result<(Envelope, Vec<M>), Refusal> {
    within_size(bytes)?;
    let failed = malformed(M::NAME);
    let (mut envelope, mut samples, mut rest) = (None, Vec::new(), bytes);
    // Field by field, so that the number of samples is known to be small before there is room for them.
    while !rest.is_empty() {
        let (tag, wire_type) = encoding::decode_key(&mut rest).map_err(&failed)?;
        match tag {
            ENVELOPE => {
                let envelope = envelope.get_or_insert_with(Envelope::default);
                encoding::message::merge(wire_type, envelope, &mut rest, DecodeContext::default()).map_err(&failed)?;
            }
            SAMPLES => {
                let mut form = M::Form::default();
                encoding::message::merge(wire_type, &mut form, &mut rest, DecodeContext::default()).map_err(&failed)?;
                within_samples(M::NAME, samples.len() + 1)?;
                samples.push(M::of_form(form)?);
            }
            _ => skip(wire_type, tag, &mut rest).map_err(&failed)?,
        }
    }
    Ok((envelope.ok_or(Refusal::Missing { field: "envelope" })?, samples))
}

/// The same for a topic, the samples as the bytes that they are on the bus, one after the other.
pub fn open_topic(topic: Topic, bytes: &[u8]) -> Result<(Envelope, Vec<u8>), Refusal> {
    messages::dispatch!(topic, M => open::<M>(bytes)
        .map(|(envelope, samples)| (envelope, bytemuck::cast_slice(&samples).to_vec())))
}

/// A field of a later version.
fn skip(wire_type: WireType, tag: u32, rest: &mut &[u8]) -> Result<(), prost::DecodeError> {
    encoding::skip_field(wire_type, tag, rest, DecodeContext::default())
}

/// How many messages of this size go into a batch.
pub fn room(message_bytes: usize) -> usize {
    (BYTES_MAX / 2 / message_bytes.max(1)).clamp(1, SAMPLES_MAX)
}

impl Envelope {
    /// Its bytes alone, as part of a message that has more fields.
    pub fn bytes(&self) -> Vec<u8> {
        self.encode_to_vec()
    }
}
