//! Decoder of buffer records with a known layout.
//!
//! Input: bytes of the character device.
//!
//! Output: one measurement per record.
//!
//! Time: the timestamp of the record.

use super::IioError;
use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, ParseOutcome},
};

const UT_PER_GAUSS: f64 = 100.0;

/// Layout of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Size of a record, bytes.
    pub record_bytes: usize,
    /// Body rate `in_anglvel`, rad/s.
    pub rate: Option<Vector>,
    /// Specific force `in_accel`, m/s².
    pub force: Option<Vector>,
    /// Magnetic field `in_magn`, gauss.
    pub field: Option<Vector>,
    /// Timestamp `in_timestamp`, ns.
    pub time: Option<Channel>,
    /// Clock of the timestamps.
    pub clock: Clock,
}

/// Three channels of one quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vector {
    /// Channels of x, y and z.
    pub channels: [Channel; 3],
    /// Offset added to the raw value before scaling.
    pub offset: [f64; 3],
    /// Factor from raw units to physical units.
    pub scale: [f64; 3],
    /// Rotation from sensor axes to board axes, row by row.
    pub mount_matrix: [[f64; 3]; 3],
}

/// Position and encoding of a number in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    /// Number of bytes before the value.
    pub byte_offset: usize,
    /// Number of stored bytes, 1 to 8.
    pub storage_bytes: usize,
    /// Number of significant bits, 1 to 64.
    pub bits: u32,
    /// Number of bits below the significant ones.
    pub shift: u32,
    /// `true` if the value is a two's complement number.
    pub is_signed: bool,
    /// `true` if the most significant byte comes first.
    pub is_big_endian: bool,
}

/// Clock of the timestamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// CLOCK_MONOTONIC and its variants: time since boot.
    Monotonic,
    /// CLOCK_BOOTTIME: time since boot, including suspend.
    Boottime,
    /// CLOCK_REALTIME and its variants: UNIX time.
    Realtime,
}

/// Decoded record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub(super) now_ns: Option<u64>,
    pub(super) rate_rad_s: Option<[f64; 3]>,
    pub(super) force_m_s2: Option<[f64; 3]>,
    pub(super) field_ut: Option<[f64; 3]>,
}

impl Layout {
    /// Decodes a complete record.
    pub(super) fn decode(&self, record: &[u8]) -> Sample {
        let read = |vector: Option<Vector>| vector.and_then(|vector| vector.decode(record));
        Sample {
            now_ns: self.time.and_then(|time| u64::try_from(time.read(record)?).ok()),
            rate_rad_s: read(self.rate),
            force_m_s2: read(self.force),
            field_ut: read(self.field).map(|field| field.map(|part| part * UT_PER_GAUSS)),
        }
    }
}

impl Clock {
    pub(super) fn device_time(self, now_ns: u64) -> DeviceTime {
        match self {
            Self::Monotonic | Self::Boottime => DeviceTime::SinceBoot { now_ns },
            Self::Realtime => DeviceTime::Unix { now_ns },
        }
    }
}

/// Record format of a device that measures both rate and force.
#[derive(Debug, Clone)]
pub struct Iio {
    layout: Layout,
}

impl Iio {
    /// Creates a format with this layout.
    ///
    /// # Errors
    ///
    /// Returns an error if the layout has no rate or no force.
    pub fn new(layout: Layout) -> Result<Self, IioError> {
        match (layout.rate, layout.force) {
            (Some(_), Some(_)) => Ok(Self { layout }),
            (None, _) => Err(IioError::MissingChannels { missing: "in_anglvel" }),
            (_, None) => Err(IioError::MissingChannels { missing: "in_accel" }),
        }
    }
}

impl Format for Iio {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        let record_bytes = self.layout.record_bytes;
        let Some(record) = bytes.get(..record_bytes) else { return ParseOutcome::Incomplete };
        let Sample { now_ns, rate_rad_s: Some(rate_rad_s), force_m_s2: Some(force_m_s2), field_ut } =
            self.layout.decode(record)
        else {
            return ParseOutcome::RejectedUnit(record_bytes);
        };
        let time = now_ns.map(|now_ns| self.layout.clock.device_time(now_ns));
        measurements.push(Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut } });
        ParseOutcome::Frame(record_bytes)
    }
}

impl Vector {
    fn decode(&self, record: &[u8]) -> Option<[f64; 3]> {
        let mut vector = [0.0; 3];
        for (axis, part) in vector.iter_mut().enumerate() {
            *part = (self.channels[axis].read(record)? as f64 + self.offset[axis]) * self.scale[axis];
        }
        Some(self.mount_matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()))
    }
}

impl Channel {
    /// Returns the value in `record`, or `None` if the record is too short or the value does not
    /// fit into an `i64`.
    fn read(&self, record: &[u8]) -> Option<i64> {
        let stored = record.get(self.byte_offset..self.byte_offset.checked_add(self.storage_bytes)?)?;
        let joined = |all: u64, byte: &u8| all << 8 | u64::from(*byte);
        let word = if self.is_big_endian { stored.iter().fold(0, joined) } else { stored.iter().rev().fold(0, joined) };
        // Shifts the value to the upper end of the word and back, with or without sign extension.
        let unused_bits = 64u32.checked_sub(self.bits)?;
        let upper = word.checked_shr(self.shift)?.checked_shl(unused_bits)?;
        if self.is_signed {
            (upper.cast_signed()).checked_shr(unused_bits)
        } else {
            upper.checked_shr(unused_bits)?.try_into().ok()
        }
    }
}
