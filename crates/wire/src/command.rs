//! Requests to a running system and their responses, decoded from untrusted bytes.

use prost::Message;

use crate::{
    DecodeError,
    error::{check_size, malformed},
    v1::{Envelope, GatewayReport, Services, SwapAnswer, SwapRequest},
};

/// Maximum length of a name, bytes.
pub const MAX_NAME_BYTES: usize = 64;
/// Maximum number of parameters in a swap request.
pub const MAX_PARAMETERS: usize = 64;
/// Maximum number of services or topics in a message.
const MAX_SERVICES: usize = 64;
/// Maximum length of a reason, bytes.
const MAX_REASON_BYTES: usize = 4096;

/// Protobuf message that is sent without an envelope.
pub trait ControlMessage: Message + Default {
    /// Name of the message in the package `plumbline.v1`.
    const NAME: &'static str;

    /// Checks the values of the fields.
    ///
    /// # Errors
    ///
    /// Returns the first missing or invalid field.
    fn validate(&self) -> Result<(), DecodeError>;

    /// Encodes the message.
    fn to_bytes(&self) -> Vec<u8> {
        self.encode_to_vec()
    }

    /// Decodes and validates a message from untrusted bytes.
    ///
    /// # Errors
    ///
    /// Returns an error if the bytes exceed the size limit, are not a message of this type, or have
    /// an invalid field.
    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        check_size(bytes)?;
        let message = Self::decode(bytes).map_err(malformed(Self::NAME))?;
        message.validate()?;
        Ok(message)
    }
}

impl ControlMessage for SwapRequest {
    const NAME: &'static str = "SwapRequest";

    fn validate(&self) -> Result<(), DecodeError> {
        for (field, name) in [("request_id", &self.request_id), ("slot", &self.slot), ("stage", &self.stage)] {
            check_text(name, field, MAX_NAME_BYTES)?;
            if name.is_empty() {
                return Err(DecodeError::Missing { field });
            }
        }
        check_parameters(Self::NAME, self.set.iter().map(|(name, value)| (&**name, *value)))?;
        if self.expected_epoch == 0 {
            return Err(DecodeError::Missing { field: "expected_epoch" });
        }
        if self.t_deadline_ns == 0 {
            return Err(DecodeError::Missing { field: "t_deadline_ns" });
        }
        Ok(())
    }
}

impl ControlMessage for SwapAnswer {
    const NAME: &'static str = "SwapAnswer";

    fn validate(&self) -> Result<(), DecodeError> {
        check_text(&self.reason, "reason", MAX_REASON_BYTES)?;
        check_finite(self.gap_s, "gap_s")?;
        check_finite(self.jump_rad, "jump_rad")
    }
}

impl ControlMessage for Services {
    const NAME: &'static str = "Services";

    fn validate(&self) -> Result<(), DecodeError> {
        if self.services.len() > MAX_SERVICES {
            return Err(DecodeError::TooMany { message: Self::NAME, what: "services", max: MAX_SERVICES });
        }
        self.services.iter().try_for_each(|service| check_text(&service.service, "service", MAX_NAME_BYTES))
    }
}

impl ControlMessage for GatewayReport {
    const NAME: &'static str = "GatewayReport";

    fn validate(&self) -> Result<(), DecodeError> {
        if self.topics.len() > MAX_SERVICES {
            return Err(DecodeError::TooMany { message: Self::NAME, what: "topics", max: MAX_SERVICES });
        }
        self.envelope.ok_or(DecodeError::Missing { field: "envelope" }).map(|_: Envelope| ())
    }
}

/// Rejects more than [`MAX_PARAMETERS`] parameters, malformed names, and values that are not
/// finite.
pub(crate) fn check_parameters<'p>(
    message: &'static str,
    parameters: impl ExactSizeIterator<Item = (&'p str, f64)>,
) -> Result<(), DecodeError> {
    if parameters.len() > MAX_PARAMETERS {
        return Err(DecodeError::TooMany { message, what: "parameters", max: MAX_PARAMETERS });
    }
    for (name, value) in parameters {
        check_text(name, "set", MAX_NAME_BYTES)?;
        check_finite(value, "set")?;
    }
    Ok(())
}

/// Rejects a text that exceeds `max` bytes or contains control characters other than line feeds.
pub(crate) fn check_text(text: &str, field: &'static str, max: usize) -> Result<(), DecodeError> {
    if text.len() <= max && !text.chars().any(|letter| letter.is_control() && letter != '\n') {
        return Ok(());
    }
    let value = format!("{} bytes", text.len());
    Err(DecodeError::OutOfRange { field, value, expected: "a short text without control characters" })
}

fn check_finite(number: f64, field: &'static str) -> Result<(), DecodeError> {
    if number.is_finite() { Ok(()) } else { Err(DecodeError::NotFinite { field }) }
}
