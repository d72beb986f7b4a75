//! Why bytes are no message.

use crate::{BYTES_MAX, SAMPLES_MAX, v1};

/// Why bytes are no message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// More bytes than any message has.
    #[error("reading a message: {bytes} bytes, {BYTES_MAX} at most; is it of another program?")]
    TooLarge {
        /// How many there are.
        bytes: usize,
    },
    /// Not protobuf, or not of that type.
    #[error("reading a {message}: {cause}; are both ends of one version?")]
    Malformed {
        /// The type that was expected.
        message: &'static str,
        /// What prost says.
        cause: String,
    },
    /// More of something than there may be.
    #[error("reading a {message}: more {what} than {max}")]
    TooMany {
        /// The type that was expected.
        message: &'static str,
        /// Of what.
        what: &'static str,
        /// How many there may be.
        max: usize,
    },
    /// A field that must be there is not.
    #[error("reading a message: `{field}` is missing")]
    Missing {
        /// The field.
        field: &'static str,
    },
    /// A number that is not finite where it must be.
    #[error("reading a message: `{field}` is not finite")]
    NotFinite {
        /// The field.
        field: &'static str,
    },
    /// A value that the field cannot have.
    #[error("reading a message: `{field}` cannot be {value}; expected {expected}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
}

/// Bytes that were no message, counted by what was wrong with them.
pub type Refusals = v1::Refusals;

impl Refusals {
    /// Counts one.
    pub fn count(&mut self, refusal: &Refusal) {
        *match refusal {
            Refusal::TooLarge { .. } => &mut self.too_large,
            Refusal::Malformed { .. } => &mut self.malformed,
            Refusal::TooMany { .. } => &mut self.too_many,
            Refusal::Missing { .. } => &mut self.missing,
            Refusal::NotFinite { .. } => &mut self.not_finite,
            Refusal::OutOfRange { .. } => &mut self.out_of_range,
        } += 1;
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        let Self { too_large, malformed, too_many, missing, not_finite, out_of_range } = self;
        too_large + malformed + too_many + missing + not_finite + out_of_range
    }
}

/// Refuses what no message is as large as.
pub(crate) fn within_size(bytes: &[u8]) -> Result<(), Refusal> {
    if bytes.len() > BYTES_MAX { Err(Refusal::TooLarge { bytes: bytes.len() }) } else { Ok(()) }
}

/// Refuses more samples than a message has.
pub(crate) fn within_samples(message: &'static str, samples: usize) -> Result<(), Refusal> {
    if samples > SAMPLES_MAX {
        return Err(Refusal::TooMany { message, what: "samples", max: SAMPLES_MAX });
    }
    Ok(())
}

pub(crate) fn malformed(message: &'static str) -> impl Fn(prost::DecodeError) -> Refusal {
    move |cause| Refusal::Malformed { message, cause: cause.to_string() }
}
