//! Records of a buffer, whose layout is known.
//!
//! Input: bytes of the character device. Output: one measurement for each record. Time: the record's stamp. Failure: none; a record is
//! what it is.

use super::IioError;
use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, Seen},
};

const UT_PER_GAUSS: f64 = 100.0;

/// How a record is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Bytes of a record.
    pub record_bytes: usize,
    /// Of `in_anglvel`, rad/s.
    pub rate: Option<Vector>,
    /// Of `in_accel`, m/s².
    pub force: Option<Vector>,
    /// Of `in_magn`, gauss.
    pub field: Option<Vector>,
    /// Of `in_timestamp`, ns.
    pub time: Option<Channel>,
    /// Of the time stamps.
    pub clock: Clock,
}

/// Three channels that belong together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vector {
    /// x, y, z.
    pub channels: [Channel; 3],
    /// Added to what is read, before the scale.
    pub offset: [f64; 3],
    /// Units of one.
    pub scale: [f64; 3],
    /// From the sensor's axes to those of the board, row by row.
    pub mount: [[f64; 3]; 3],
}

/// Where a number is, and how it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    /// Bytes before it.
    pub at: usize,
    /// Bytes it takes, 1 to 8.
    pub bytes: usize,
    /// Bits that count, 1 to 64.
    pub bits: u32,
    /// Bits below those.
    pub shift: u32,
    /// Negative ones are two's complements.
    pub is_signed: bool,
    /// The highest byte is the first.
    pub is_big_endian: bool,
}

/// What time stamps count from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// CLOCK_MONOTONIC, or one of its kind: from the start.
    Monotonic,
    /// CLOCK_BOOTTIME: from the start, with the time asleep.
    Boottime,
    /// CLOCK_REALTIME, or one of its kind: from 1970.
    Realtime,
}

/// What a record says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub(super) now_ns: Option<u64>,
    pub(super) rate_rad_s: Option<[f64; 3]>,
    pub(super) force_m_s2: Option<[f64; 3]>,
    pub(super) field_ut: Option<[f64; 3]>,
}

impl Layout {
    /// Of a whole record.
    pub(super) fn sample(&self, record: &[u8]) -> Sample {
        let of = |vector: Option<Vector>| vector.and_then(|vector| vector.of(record));
        Sample {
            now_ns: self.time.and_then(|time| u64::try_from(time.of(record)?).ok()),
            rate_rad_s: of(self.rate),
            force_m_s2: of(self.force),
            field_ut: of(self.field).map(|field| field.map(|part| part * UT_PER_GAUSS)),
        }
    }
}

impl Clock {
    pub(super) fn time(self, now_ns: u64) -> DeviceTime {
        match self {
            Self::Monotonic | Self::Boottime => DeviceTime::SinceBoot { now_ns },
            Self::Realtime => DeviceTime::Unix { now_ns },
        }
    }
}

/// Records of one device with rate and force.
#[derive(Debug, Clone)]
pub struct Iio {
    layout: Layout,
}

impl Iio {
    /// Of this layout, which has both.
    pub fn new(layout: Layout) -> Result<Self, IioError> {
        match (layout.rate, layout.force) {
            (Some(_), Some(_)) => Ok(Self { layout }),
            (None, _) => Err(IioError::Missing { missing: "in_anglvel" }),
            (_, None) => Err(IioError::Missing { missing: "in_accel" }),
        }
    }
}

impl Format for Iio {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        let record_bytes = self.layout.record_bytes;
        let Some(record) = bytes.get(..record_bytes) else { return Seen::More };
        let Sample { now_ns, rate_rad_s: Some(rate_rad_s), force_m_s2: Some(force_m_s2), field_ut } =
            self.layout.sample(record)
        else {
            return Seen::RefusedLine(record_bytes);
        };
        let time = now_ns.map(|now_ns| self.layout.clock.time(now_ns));
        found.push(Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut } });
        Seen::Frame(record_bytes)
    }
}

impl Vector {
    fn of(&self, record: &[u8]) -> Option<[f64; 3]> {
        let mut vector = [0.0; 3];
        for (axis, part) in vector.iter_mut().enumerate() {
            *part = (self.channels[axis].of(record)? as f64 + self.offset[axis]) * self.scale[axis];
        }
        Some(self.mount.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()))
    }
}

impl Channel {
    /// `None` beyond the end of the record.
    fn of(&self, record: &[u8]) -> Option<i64> {
        let stored = record.get(self.at..self.at.checked_add(self.bytes)?)?;
        let joined = |all: u64, byte: &u8| all << 8 | u64::from(*byte);
        let word = if self.is_big_endian { stored.iter().fold(0, joined) } else { stored.iter().rev().fold(0, joined) };
        // To the upper end, and back with or without the sign.
        let above = 64u32.checked_sub(self.bits)?;
        let upper = word.checked_shr(self.shift)?.checked_shl(above)?;
        if self.is_signed {
            (upper.cast_signed()).checked_shr(above)
        } else {
            upper.checked_shr(above)?.try_into().ok()
        }
    }
}
