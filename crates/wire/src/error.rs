//! Errors in decoding untrusted bytes, and counts of these errors.

use crate::{MAX_MESSAGE_BYTES, MAX_SAMPLES, v1};

/// Reason for rejecting bytes as a message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DecodeError {
    /// The message exceeds the maximum size.
    #[error("cannot decode message: {bytes} bytes, at most {MAX_MESSAGE_BYTES} allowed; check that the peer is plumb")]
    TooLarge {
        /// Size of the message, bytes.
        bytes: usize,
    },
    /// The bytes are not protobuf, or not a message of the expected type.
    #[error("cannot decode {message}: {cause}; run the same version of plumb at both ends")]
    Malformed {
        /// Expected message type.
        message: &'static str,
        /// Error reported by the protobuf decoder.
        cause: String,
    },
    /// A repeated or variable-length field exceeds its limit.
    #[error("cannot decode {message}: more than {max} {what}")]
    TooMany {
        /// Expected message type.
        message: &'static str,
        /// Unit of the limit, such as `samples` or `bytes`.
        what: &'static str,
        /// Maximum allowed number.
        max: usize,
    },
    /// A required field is missing.
    #[error("cannot decode message: `{field}` is missing")]
    Missing {
        /// Name of the field.
        field: &'static str,
    },
    /// A number is NaN or infinite.
    #[error("cannot decode message: `{field}` is not finite")]
    NotFinite {
        /// Name of the field.
        field: &'static str,
    },
    /// A field has a value outside its range.
    #[error("cannot decode message: `{field}` is {value}; expected {expected}")]
    OutOfRange {
        /// Name of the field.
        field: &'static str,
        /// Invalid value.
        value: String,
        /// Allowed values.
        expected: &'static str,
    },
}

/// Number of decode errors by kind.
pub type DecodeErrorCounts = v1::Rejections;

impl DecodeErrorCounts {
    /// Counts an error.
    pub fn count(&mut self, error: &DecodeError) {
        *match error {
            DecodeError::TooLarge { .. } => &mut self.too_large,
            DecodeError::Malformed { .. } => &mut self.malformed,
            DecodeError::TooMany { .. } => &mut self.too_many,
            DecodeError::Missing { .. } => &mut self.missing,
            DecodeError::NotFinite { .. } => &mut self.not_finite,
            DecodeError::OutOfRange { .. } => &mut self.out_of_range,
        } += 1;
    }

    /// Returns the total number of errors.
    pub fn total(&self) -> u64 {
        let Self { too_large, malformed, too_many, missing, not_finite, out_of_range } = self;
        too_large + malformed + too_many + missing + not_finite + out_of_range
    }
}

/// Rejects bytes that exceed the maximum message size.
pub(crate) fn check_size(bytes: &[u8]) -> Result<(), DecodeError> {
    if bytes.len() > MAX_MESSAGE_BYTES { Err(DecodeError::TooLarge { bytes: bytes.len() }) } else { Ok(()) }
}

/// Rejects a number of samples that exceeds the limit of a batch.
pub(crate) fn check_sample_count(message: &'static str, samples: usize) -> Result<(), DecodeError> {
    if samples > MAX_SAMPLES {
        return Err(DecodeError::TooMany { message, what: "samples", max: MAX_SAMPLES });
    }
    Ok(())
}

pub(crate) fn malformed(message: &'static str) -> impl Fn(prost::DecodeError) -> DecodeError {
    move |cause| DecodeError::Malformed { message, cause: cause.to_string() }
}
