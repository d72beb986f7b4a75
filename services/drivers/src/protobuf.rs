//! Length-delimited protobuf messages: each [`v1::Measurement`] is preceded by its length, as
//! written by protobuf's own libraries (`writeDelimitedTo`, `serialize_length_prefixed`).
//!
//! Limits: there is no checksum and no start marker. After invalid bytes, a message is recognised
//! only by a possible length and by fields that can be decoded.

use decoders::{
    DeviceTime, Measurement, Position, Value,
    framed::{Format, ParseOutcome},
};
use wire::{measurement, v1};

/// Maximum length of a message, in bytes.
const MAX_MESSAGE_BYTES: usize = 512;
/// Size of the length prefix of the longest message, in bytes.
const LENGTH_BYTES: usize = 2;
const CONTINUATION: u8 = 0x80;

/// Format of length-delimited messages. It has no settings.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Protobuf;

impl Format for Protobuf {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        let Some((prefix_bytes, length)) = length(bytes) else {
            return if bytes.len() < LENGTH_BYTES { ParseOutcome::Incomplete } else { ParseOutcome::Skip(1) };
        };
        if length == 0 || length > MAX_MESSAGE_BYTES {
            return ParseOutcome::Skip(1);
        }
        let Some(message) = bytes.get(prefix_bytes..prefix_bytes + length) else { return ParseOutcome::Incomplete };
        match measurement::decode(message) {
            Ok(message) => {
                push_measurements(&message, measurements);
                ParseOutcome::Frame(prefix_bytes + length)
            }
            Err(_) => ParseOutcome::Rejected,
        }
    }
}

/// Returns the size of the length prefix and the message length that it encodes.
fn length(bytes: &[u8]) -> Option<(usize, usize)> {
    match *bytes {
        [low, ..] if low & CONTINUATION == 0 => Some((1, low.into())),
        [low, high, ..] if high & CONTINUATION == 0 => {
            Some((2, usize::from(low & !CONTINUATION) | usize::from(high) << 7))
        }
        _ => None,
    }
}

/// Appends the measurements of a message. A fix precedes the reading of the same instant.
fn push_measurements(message: &v1::Measurement, measurements: &mut Vec<Measurement>) {
    let three = |v1::Vector3 { x, y, z }: v1::Vector3| [x, y, z];
    // A time before the zero of the device's clock is negative and is stored as two's complement.
    let time = message.t_ns.map(|t_ns| DeviceTime::SinceBoot { now_ns: t_ns.cast_unsigned() });
    let mut push = |value| measurements.push(Measurement { time, value });
    if let Some(velocity) = message.velocity_m_s {
        let (latitude_rad, longitude_rad, altitude_m) =
            (message.latitude_rad, message.longitude_rad, message.altitude_m);
        let position = Position { latitude_rad, longitude_rad, altitude_m };
        push(Value::Fix { velocity_m_s: three(velocity), sd_m_s: message.velocity_sd_m_s, position });
    }
    let field_ut = message.field_ut.map(three);
    match (message.rate_rad_s.map(three), message.force_m_s2.map(three)) {
        (Some(rate_rad_s), Some(force_m_s2)) => push(Value::Imu { rate_rad_s, force_m_s2, field_ut }),
        _ => field_ut.into_iter().for_each(|field_ut| push(Value::Field(field_ut))),
    }
}
