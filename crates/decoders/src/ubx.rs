//! u-blox receivers: UBX-NAV-PVT.
//!
//! A frame consists of 0xB5 0x62, class, id, a two-byte length, the payload and a two-byte Fletcher
//! checksum. A NAV-PVT has 92 bytes since u-blox 8 and had 84 bytes before. It yields a fix:
//!
//! - `velN`, `velE`, `velD` give the velocity east, north, up.
//! - `sAcc` gives the standard deviation. It is at least [`crate::ASSUMED_VERTICAL_SD_M_S`] for a
//!   two-dimensional fix, whose vertical velocity is assumed.
//! - `lat`, `lon`, `hMSL` give the position unless it is marked invalid. The 84-byte message has no
//!   such mark.
//! - Date and time give the UNIX time if both are valid.
//!
//! A message yields a fix only if `gnssFixOK` is set. Other frames are counted. NMEA and RTCM
//! between the frames count as skipped bytes.

use crate::{
    ASSUMED_VERTICAL_SD_M_S, DeviceTime, Measurement, Position, Value,
    framed::{Format, ParseOutcome},
};

const SYNC_1: u8 = 0xb5;
const SYNC_2: u8 = 0x62;
const HEADER_BYTES: usize = 6;
const CHECKSUM_BYTES: usize = 2;
/// Maximum length of a payload. It exceeds the longest regular payloads, which are the raw
/// measurements of a hundred signals.
const MAX_PAYLOAD_BYTES: usize = 4096;
const CLASS_NAV: u8 = 0x01;
const ID_PVT: u8 = 0x07;
/// Lengths of a NAV-PVT payload before and since u-blox 8. If a frame has any other length, its
/// length field is corrupted. Such a frame is rejected immediately, because waiting for its end
/// would delay the next fixes.
const PVT_LENGTHS_BYTES: [usize; 2] = [SHORT_PVT_BYTES, 92];
/// Length of the NAV-PVT payload before u-blox 8. The longer payload starts with the same fields.
const SHORT_PVT_BYTES: usize = 84;

/// UBX format. It has no settings.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ubx;

impl Format for Ubx {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        match bytes {
            [SYNC_1] => return ParseOutcome::Incomplete,
            [SYNC_1, SYNC_2, ..] => {}
            _ => return ParseOutcome::Skip(1),
        }
        let Some(&[_, _, class, id, low, high]) = bytes.first_chunk::<HEADER_BYTES>() else {
            return ParseOutcome::Incomplete;
        };
        let length = usize::from(u16::from_le_bytes([low, high]));
        let is_pvt = (class, id) == (CLASS_NAV, ID_PVT);
        if length > MAX_PAYLOAD_BYTES || (is_pvt && !PVT_LENGTHS_BYTES.contains(&length)) {
            return ParseOutcome::Rejected;
        }
        let Some(frame) = bytes.get(..HEADER_BYTES + length + CHECKSUM_BYTES) else { return ParseOutcome::Incomplete };
        let (covered, checksum) = frame.split_at(HEADER_BYTES + length);
        if fletcher(&covered[2..]) != checksum {
            return ParseOutcome::Rejected;
        }
        if is_pvt && let Some((start, rest)) = covered[HEADER_BYTES..].split_first_chunk() {
            measurements.extend(NavPvt::parse(start, !rest.is_empty()).fix());
        }
        ParseOutcome::Frame(frame.len())
    }
}

fn fletcher(bytes: &[u8]) -> [u8; 2] {
    bytes.iter().fold([0, 0], |[a, b]: [u8; 2], byte| {
        let a = a.wrapping_add(*byte);
        [a, b.wrapping_add(a)]
    })
}

/// Fields of a NAV-PVT payload from which a fix is built, in the units of the message.
struct NavPvt {
    year: u16,
    month: u8,
    day: u8,
    hour: u8,
    minute: u8,
    second: u8,
    valid: u8,
    nano_ns: i32,
    fix_type: u8,
    flags: u8,
    longitude_e7_deg: i32,
    latitude_e7_deg: i32,
    height_msl_mm: i32,
    velocity_ned_mm_s: [i32; 3],
    speed_accuracy_mm_s: u32,
    flags3: u8,
}

/// Bits of `valid`.
const VALID_DATE: u8 = 1 << 0;
const VALID_TIME: u8 = 1 << 1;
/// Bit `gnssFixOK` of `flags`.
const GNSS_FIX_OK: u8 = 1 << 0;
/// Bit `invalidLlh` of `flags3`.
const INVALID_LLH: u8 = 1 << 0;
/// Values of `fixType` for which the receiver reports a velocity.
const FIX_2D: u8 = 2;
const FIX_3D: u8 = 3;
const GNSS_AND_DEAD_RECKONING: u8 = 4;

impl NavPvt {
    /// Reads the fields at the offsets that the interface description defines for protocol versions
    /// 15 to 34. The 84-byte payload of version 14 has no `flags3`.
    fn parse(payload: &[u8; SHORT_PVT_BYTES], has_flags3: bool) -> Self {
        let four = |at: usize| [payload[at], payload[at + 1], payload[at + 2], payload[at + 3]];
        let signed = |at| i32::from_le_bytes(four(at));
        Self {
            year: u16::from_le_bytes([payload[4], payload[5]]),
            month: payload[6],
            day: payload[7],
            hour: payload[8],
            minute: payload[9],
            second: payload[10],
            valid: payload[11],
            nano_ns: signed(16),
            fix_type: payload[20],
            flags: payload[21],
            longitude_e7_deg: signed(24),
            latitude_e7_deg: signed(28),
            height_msl_mm: signed(36),
            velocity_ned_mm_s: [48, 52, 56].map(signed),
            speed_accuracy_mm_s: u32::from_le_bytes(four(68)),
            flags3: if has_flags3 { payload[78] } else { 0 },
        }
    }

    /// Returns the fix, or `None` if the message has no usable velocity.
    fn fix(&self) -> Option<Measurement> {
        let min_sd_m_s = match self.fix_type {
            FIX_3D | GNSS_AND_DEAD_RECKONING => 0.0,
            FIX_2D => ASSUMED_VERTICAL_SD_M_S,
            _ => return None,
        };
        if self.flags & GNSS_FIX_OK == 0 {
            return None;
        }
        let [north, east, down] = self.velocity_ned_mm_s.map(|part| f64::from(part) * 1e-3);
        let value = Value::Fix {
            velocity_m_s: [east, north, -down],
            sd_m_s: Some((f64::from(self.speed_accuracy_mm_s) * 1e-3).max(min_sd_m_s)),
            position: if self.flags3 & INVALID_LLH != 0 {
                Position::default()
            } else {
                let [latitude, longitude] = [self.latitude_e7_deg, self.longitude_e7_deg].map(|x| f64::from(x) * 1e-7);
                Position::from_degrees(latitude, longitude, f64::from(self.height_msl_mm) * 1e-3)
            },
        };
        Some(Measurement { time: self.unix_time(), value })
    }

    fn unix_time(&self) -> Option<DeviceTime> {
        if self.valid & VALID_DATE == 0 || self.valid & VALID_TIME == 0 {
            return None;
        }
        let date = chrono::NaiveDate::from_ymd_opt(self.year.into(), self.month.into(), self.day.into())?;
        let midnight_s = date.and_hms_opt(0, 0, 0)?.and_utc().timestamp();
        // The time is computed arithmetically, because the seconds may be 60 in a leap second and
        // the nanoseconds may be negative.
        let now_s = midnight_s + (i64::from(self.hour) * 60 + i64::from(self.minute)) * 60 + i64::from(self.second);
        let now_ns = now_s.checked_mul(1_000_000_000)?.checked_add(self.nano_ns.into())?;
        Some(DeviceTime::Unix { now_ns: u64::try_from(now_ns).ok()? })
    }
}
