//! WitMotion sensors (WT61, WT901, HWT901B …) on a serial line: 11-byte frames that start with
//! 0x55.
//!
//! A frame consists of 0x55, a byte for its kind, four little-endian 16-bit numbers and the sum of
//! the ten preceding bytes (WIT standard protocol). In each cycle the device sends the enabled
//! kinds in ascending order:
//!
//! | kind | content | result |
//! | --- | --- | --- |
//! | 0x50 | device's calendar time, ms | timestamp of the cycle: UNIX time with 1 ms resolution, if the calendar is set |
//! | 0x51 | acceleration, ±range over ±2¹⁵ | specific force, combined with the following 0x52 |
//! | 0x52 | rate, ±range over ±2¹⁵ | body rate |
//! | 0x54 | magnetic field, in model-specific units | separate measurement, because this frame follows the rate |
//! | others | angles, pressure, position … | counted |
//!
//! Axes: as printed on the device, on most models x right, y forward, z up. At rest the specific
//! force points up.
//!
//! Time: `None` unless 0x50 is enabled. It is disabled by default.
//!
//! Limits: the device filters its measurements, and most models send at most 200 Hz. A rate without
//! a force of the same cycle, or a force without a rate, is counted and yields no measurement.
//! Because the checksum has only 8 bits, one in 256 corrupted frames is accepted.

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, ParseOutcome, three_i16, wrapping_sum},
};

const FRAME_BYTES: usize = 11;
const SYNC: u8 = 0x55;
const KINDS: std::ops::RangeInclusive<u8> = 0x50..=0x5f;
const TIME: u8 = 0x50;
const FORCE: u8 = 0x51;
const RATE: u8 = 0x52;
const FIELD: u8 = 0x54;
const FULL_SCALE: f64 = 32_768.0;
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;

/// Frame format of WitMotion sensors, with the state of the current cycle.
#[derive(Debug, Clone)]
pub struct WitMotion {
    ranges: Ranges,
    /// Timestamps of the next and of the current cycle.
    time: [Option<DeviceTime>; 2],
    force_m_s2: Option<[f64; 3]>,
    skipped_bytes: usize,
}

/// Full-scale ranges of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ranges {
    /// Range of the accelerometer, g.
    pub force_g: f64,
    /// Range of the gyro, °/s.
    pub rate_deg_s: f64,
    /// Magnetic field in µT that one magnetometer unit represents. `None` ignores the magnetometer.
    /// WitMotion specifies 1 mG (0.1 µT) for newer models and no unit for older ones.
    pub field_ut: Option<f64>,
}

impl WitMotion {
    /// Creates the format of a device with these ranges.
    pub fn new(ranges: Ranges) -> Self {
        Self { ranges, time: [None; 2], force_m_s2: None, skipped_bytes: 0 }
    }

    fn process(&mut self, kind: u8, numbers: &[u8], measurements: &mut Vec<Measurement>) -> Option<()> {
        let three = three_i16(numbers, 0)?;
        // If less than a frame was skipped, force and rate belong to the same cycle.
        let force_m_s2 = self.force_m_s2.take().filter(|_| self.skipped_bytes < FRAME_BYTES);
        match kind {
            TIME => self.time = [numbers.first_chunk().and_then(unix_time), None],
            FORCE => {
                self.time = [None, self.time[0]];
                self.force_m_s2 =
                    Some(three.map(|part| part / FULL_SCALE * self.ranges.force_g * STANDARD_GRAVITY_M_S2));
            }
            RATE => {
                let rate_rad_s = three.map(|part| (part / FULL_SCALE * self.ranges.rate_deg_s).to_radians());
                let value = Value::Imu { rate_rad_s, force_m_s2: force_m_s2?, field_ut: None };
                measurements.push(Measurement { time: self.time[1], value });
            }
            FIELD => {
                let field_ut = self.ranges.field_ut?;
                measurements
                    .push(Measurement { time: self.time[1], value: Value::Field(three.map(|part| part * field_ut)) });
            }
            _ => {}
        }
        Some(())
    }
}

impl Format for WitMotion {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        match bytes {
            [SYNC] => return ParseOutcome::Incomplete,
            [SYNC, kind, ..] if KINDS.contains(kind) => {}
            _ => return ParseOutcome::Skip(1),
        }
        let Some(frame) = bytes.first_chunk::<FRAME_BYTES>() else { return ParseOutcome::Incomplete };
        let [covered @ .., checksum] = frame;
        if wrapping_sum(covered) != *checksum {
            return ParseOutcome::Rejected;
        }
        self.process(frame[1], &frame[2..], measurements);
        self.skipped_bytes = 0;
        ParseOutcome::Frame(FRAME_BYTES)
    }

    fn on_skipped(&mut self, bytes: usize) {
        self.skipped_bytes = self.skipped_bytes.saturating_add(bytes);
    }
}

/// Returns the timestamp given by the device's calendar, or `None` if the date or the time is
/// invalid. The year counts from 2000.
fn unix_time(&[year, month, day, hour, minute, second, low, high]: &[u8; 8]) -> Option<DeviceTime> {
    let date = chrono::NaiveDate::from_ymd_opt(2000 + i32::from(year), month.into(), day.into())?;
    let milli = u32::from(u16::from_le_bytes([low, high]));
    let time = date.and_hms_milli_opt(hour.into(), minute.into(), second.into(), milli)?;
    let now_ns = u64::try_from(time.and_utc().timestamp_nanos_opt()?).ok()?;
    Some(DeviceTime::Unix { now_ns })
}
