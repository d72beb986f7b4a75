//! Measurements that a program sends to a `protobuf` source: [`v1::Measurement`].

use prost::Message as _;

use crate::{DecodeError, error, v1};

const NAME: &str = "Measurement";

/// Decodes a measurement from untrusted bytes.
///
/// # Errors
///
/// Returns an error if the bytes are not a measurement, if it has only one of rate and specific
/// force, or if it has no vector quantity at all.
pub fn decode(bytes: &[u8]) -> Result<v1::Measurement, DecodeError> {
    error::check_size(bytes)?;
    let measurement = v1::Measurement::decode(bytes).map_err(error::malformed(NAME))?;
    let v1::Measurement { rate_rad_s, force_m_s2, field_ut, velocity_m_s, .. } = &measurement;
    match (rate_rad_s, force_m_s2) {
        (Some(_), None) => Err(DecodeError::Missing { field: "force_m_s2" }),
        (None, Some(_)) => Err(DecodeError::Missing { field: "rate_rad_s" }),
        (None, None) if field_ut.is_none() && velocity_m_s.is_none() => {
            Err(DecodeError::Missing { field: "rate_rad_s" })
        }
        _ => Ok(measurement),
    }
}
