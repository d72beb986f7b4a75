//! PX4 flight logs (ULog): the samples of `sensor_combined`.
//!
//! A log is a header of 16 bytes, then messages: size (u16), type (u8), payload. `A` gives a topic its number, `D` is a sample of it.

use attitude::Vector3;

/// The topic; its samples begin with timestamp (u64, µs), gyro_rad (3 × f32), two of 4 bytes, accelerometer_m_s2 (3 × f32).
const TOPIC: &[u8] = b"sensor_combined";
const HEADER: usize = 16;

/// One sample, in the axes right, forward, up.
pub(crate) struct Sample {
    pub(crate) t_s: f64,
    pub(crate) rate_rad_s: Vector3<f64>,
    pub(crate) force_m_s2: Vector3<f64>,
}

/// The samples of a log.
pub(crate) fn samples(log: &[u8]) -> Vec<Sample> {
    let (mut rest, mut number, mut samples) = (&log[HEADER..], None, Vec::new());
    while let [low, high, kind, payload @ ..] = rest {
        let (message, after) = payload.split_at(usize::from(u16::from_le_bytes([*low, *high])));
        match kind {
            b'A' if &message[3..] == TOPIC => number = Some([message[1], message[2]]),
            b'D' if number.is_some_and(|number| message.starts_with(&number)) => samples.push(sample(&message[2..])),
            _ => {}
        }
        rest = after;
    }
    samples
}

fn sample(bytes: &[u8]) -> Sample {
    let t_us = u64::from_le_bytes(bytes[..8].try_into().unwrap());
    let number = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    // Forward, right, down there.
    let vector = |at: usize| Vector3::new(number(at + 4), number(at), -number(at + 8));
    Sample { t_s: t_us as f64 * 1e-6, rate_rad_s: vector(8), force_m_s2: vector(28) }
}
