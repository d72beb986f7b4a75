//! WitMotion sensors (WT61, WT901, HWT901B …) on a serial line: frames of 11 bytes that begin with 0x55.
//!
//! Each frame is 0x55, its kind, four numbers of 16 bits, low byte first, and the sum of the ten bytes before it (WIT standard
//! protocol). In each cycle the device sends those of the kinds that are switched on, in the order of their numbers:
//!
//! | kind | what | becomes |
//! | --- | --- | --- |
//! | 0x50 | the time of the device's calendar, ms | the time of the cycle: since 1970, if the calendar is set, in steps of 1 ms |
//! | 0x51 | acceleration, ±range over ±2¹⁵ | specific force, with the 0x52 that follows it |
//! | 0x52 | rate, ±range over ±2¹⁵ | body rate |
//! | 0x54 | magnetic field, in units of the model | a field by itself, as it comes after the rate |
//! | others | angles, pressure, position … | counted |
//!
//! Axes: those printed on the device, x right, y forward, z up on most; at rest the force is up. Time: `None` where 0x50 is switched off,
//! which it is unless it was switched on. Limits: the device filters before it sends; its rate is 200 Hz at most on most models.
//! A rate without a force of the same cycle, or the other way, is counted and makes no measurement. The sum has 8 bits: of 256 frames
//! that the line broke, one is taken for good.

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, Seen, sum, three_i16},
};

const FRAME_BYTES: usize = 11;
const BEGIN: u8 = 0x55;
const KINDS: std::ops::RangeInclusive<u8> = 0x50..=0x5f;
const TIME: u8 = 0x50;
const FORCE: u8 = 0x51;
const RATE: u8 = 0x52;
const FIELD: u8 = 0x54;
const FULL_SCALE: f64 = 32_768.0;
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;

/// The ranges of a device, and what it sent in this cycle.
#[derive(Debug, Clone)]
pub struct WitMotion {
    ranges: Ranges,
    /// Of the cycle that begins, and of the one that is on.
    time: [Option<DeviceTime>; 2],
    force_m_s2: Option<[f64; 3]>,
    passed_bytes: usize,
}

/// What the largest number stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ranges {
    /// Range of the accelerometer, g.
    pub force_g: f64,
    /// Range of the gyro, °/s.
    pub rate_deg_s: f64,
    /// What one unit of the magnetometer stands for, µT; `None` where it is not to be used. WitMotion gives mG (0.1 µT) for its newer
    /// models and no unit for older ones.
    pub field_ut: Option<f64>,
}

/// ±16 g, ±2000 °/s, 0.1 µT: as devices leave the factory.
impl Default for Ranges {
    fn default() -> Self {
        Self { force_g: 16.0, rate_deg_s: 2000.0, field_ut: Some(0.1) }
    }
}

impl WitMotion {
    /// A device with these ranges.
    pub fn new(ranges: Ranges) -> Self {
        Self { ranges, time: [None; 2], force_m_s2: None, passed_bytes: 0 }
    }

    fn take(&mut self, kind: u8, numbers: &[u8], found: &mut Vec<Measurement>) -> Option<()> {
        let three = three_i16(numbers, 0)?;
        // Less than a frame was passed over: nothing of another cycle was lost between force and rate.
        let force_m_s2 = self.force_m_s2.take().filter(|_| self.passed_bytes < FRAME_BYTES);
        match kind {
            TIME => self.time = [numbers.first_chunk().and_then(unix), None],
            FORCE => {
                self.time = [None, self.time[0]];
                self.force_m_s2 =
                    Some(three.map(|part| part / FULL_SCALE * self.ranges.force_g * STANDARD_GRAVITY_M_S2));
            }
            RATE => {
                let rate_rad_s = three.map(|part| (part / FULL_SCALE * self.ranges.rate_deg_s).to_radians());
                let value = Value::Imu { rate_rad_s, force_m_s2: force_m_s2?, field_ut: None };
                found.push(Measurement { time: self.time[1], value });
            }
            FIELD => {
                let field_ut = self.ranges.field_ut?;
                found.push(Measurement { time: self.time[1], value: Value::Field(three.map(|part| part * field_ut)) });
            }
            _ => {}
        }
        Some(())
    }
}

impl Format for WitMotion {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        match bytes {
            [BEGIN] => return Seen::More,
            [BEGIN, kind, ..] if KINDS.contains(kind) => {}
            _ => return Seen::Nothing(1),
        }
        let Some(frame) = bytes.first_chunk::<FRAME_BYTES>() else { return Seen::More };
        let [head @ .., checksum] = frame;
        if sum(head) != *checksum {
            return Seen::Refused;
        }
        self.take(frame[1], &frame[2..], found);
        self.passed_bytes = 0;
        Seen::Frame(FRAME_BYTES)
    }

    fn passed(&mut self, bytes: usize) {
        self.passed_bytes = self.passed_bytes.saturating_add(bytes);
    }
}

/// Year of this century, month, day, hour, minute, second, milliseconds; `None` where the calendar has no such time.
fn unix(&[year, month, day, hour, minute, second, low, high]: &[u8; 8]) -> Option<DeviceTime> {
    let date = chrono::NaiveDate::from_ymd_opt(2000 + i32::from(year), month.into(), day.into())?;
    let milli = u32::from(u16::from_le_bytes([low, high]));
    let time = date.and_hms_milli_opt(hour.into(), minute.into(), second.into(), milli)?;
    let now_ns = u64::try_from(time.and_utc().timestamp_nanos_opt()?).ok()?;
    Some(DeviceTime::Unix { now_ns })
}
