//! Messages of the schema in a stream of bytes: each is a [`v1::Measurement`] with its length before it, as protobuf's own
//! libraries write it (`writeDelimitedTo`, `serialize_length_prefixed`).
//!
//! Limits: there is no checksum and no mark where a message begins; behind bytes that are none, a message is found where its length, its
//! fields and its numbers fit.

use decoders::{
    DeviceTime, Measurement, Place, Value,
    framed::{Format, Seen},
};
use wire::{measurement, v1};

/// No message is longer.
const LENGTH_MAX_BYTES: usize = 512;
/// Of a length up to that.
const LENGTH_BYTES: usize = 2;
const MORE: u8 = 0x80;

/// Has no settings.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Protobuf;

impl Format for Protobuf {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        let Some((head, length)) = length(bytes) else {
            return if bytes.len() < LENGTH_BYTES { Seen::More } else { Seen::Nothing(1) };
        };
        if length == 0 || length > LENGTH_MAX_BYTES {
            return Seen::Nothing(1);
        }
        let Some(message) = bytes.get(head..head + length) else { return Seen::More };
        match measurement::decoded(message) {
            Ok(said) => {
                add(&said, found);
                Seen::Frame(head + length)
            }
            Err(_) => Seen::Refused,
        }
    }
}

/// How many bytes a length takes, and the length.
fn length(bytes: &[u8]) -> Option<(usize, usize)> {
    match *bytes {
        [low, ..] if low & MORE == 0 => Some((1, low.into())),
        [low, high, ..] if high & MORE == 0 => Some((2, usize::from(low & !MORE) | usize::from(high) << 7)),
        _ => None,
    }
}

/// What was measured at that instant; the fix is the one that goes with the reading.
fn add(said: &v1::Measurement, found: &mut Vec<Measurement>) {
    let three = |v1::Vector3 { x, y, z }: v1::Vector3| [x, y, z];
    // A time before the device's beginning comes out as it went in.
    let time = said.t_ns.map(|t_ns| DeviceTime::SinceBoot { now_ns: t_ns.cast_unsigned() });
    let mut push = |value| found.push(Measurement { time, value });
    if let Some(velocity) = said.velocity_m_s {
        let (latitude_rad, longitude_rad, altitude_m) = (said.latitude_rad, said.longitude_rad, said.altitude_m);
        let place = Place { latitude_rad, longitude_rad, altitude_m };
        push(Value::Fix { velocity_m_s: three(velocity), sd_m_s: said.velocity_sd_m_s, place });
    }
    let field_ut = said.field_ut.map(three);
    match (said.rate_rad_s.map(three), said.force_m_s2.map(three)) {
        (Some(rate_rad_s), Some(force_m_s2)) => push(Value::Imu { rate_rad_s, force_m_s2, field_ut }),
        _ => field_ut.into_iter().for_each(|field_ut| push(Value::Field(field_ut))),
    }
}
