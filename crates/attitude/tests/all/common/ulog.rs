//! PX4 flight logs (ULog): samples of the topic `sensor_combined`.
//!
//! A log consists of a 16-byte header and messages of the form size (u16), type (u8), payload. Type
//! `A` assigns an identifier to a topic, type `D` is a sample of a topic.

use attitude::Vector3;

/// Name of the topic with the gyro and accelerometer samples.
///
/// A sample starts with timestamp (u64, µs), gyro_rad (3 × f32), two values of 4 bytes each and
/// accelerometer_m_s2 (3 × f32).
const TOPIC: &[u8] = b"sensor_combined";
const HEADER_BYTES: usize = 16;

/// Sample in the axes right, forward, up.
pub(crate) struct Sample {
    pub(crate) t_s: f64,
    pub(crate) rate_rad_s: Vector3<f64>,
    pub(crate) force_m_s2: Vector3<f64>,
}

/// Returns the samples of a log.
pub(crate) fn samples(log: &[u8]) -> Vec<Sample> {
    let (mut rest, mut topic_id, mut samples) = (&log[HEADER_BYTES..], None, Vec::new());
    while let [low, high, kind, payload @ ..] = rest {
        let (message, after) = payload.split_at(usize::from(u16::from_le_bytes([*low, *high])));
        match kind {
            b'A' if &message[3..] == TOPIC => topic_id = Some([message[1], message[2]]),
            b'D' if topic_id.is_some_and(|topic_id| message.starts_with(&topic_id)) => {
                samples.push(sample(&message[2..]))
            }
            _ => {}
        }
        rest = after;
    }
    samples
}

fn sample(bytes: &[u8]) -> Sample {
    let t_us = u64::from_le_bytes(bytes[..8].try_into().unwrap());
    let float = |offset: usize| f64::from(f32::from_le_bytes(bytes[offset..offset + 4].try_into().unwrap()));
    // The axes of the log are forward, right, down.
    let vector = |offset: usize| Vector3::new(float(offset + 4), float(offset), -float(offset + 8));
    Sample { t_s: t_us as f64 * 1e-6, rate_rad_s: vector(8), force_m_s2: vector(28) }
}
