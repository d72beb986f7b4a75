//! What a program sends that has sensors: [`v1::Measurement`].

use prost::Message as _;

use crate::{Refusal, refusal, v1};

const NAME: &str = "Measurement";

/// The measurement of bytes from anywhere. A rate has a force with it, and a force a rate; something was measured.
pub fn decoded(bytes: &[u8]) -> Result<v1::Measurement, Refusal> {
    refusal::within_size(bytes)?;
    let measurement = v1::Measurement::decode(bytes).map_err(refusal::malformed(NAME))?;
    let v1::Measurement { rate_rad_s, force_m_s2, field_ut, velocity_m_s, .. } = &measurement;
    match (rate_rad_s, force_m_s2) {
        (Some(_), None) => Err(Refusal::Missing { field: "force_m_s2" }),
        (None, Some(_)) => Err(Refusal::Missing { field: "rate_rad_s" }),
        (None, None) if field_ut.is_none() && velocity_m_s.is_none() => Err(Refusal::Missing { field: "rate_rad_s" }),
        _ => Ok(measurement),
    }
}
