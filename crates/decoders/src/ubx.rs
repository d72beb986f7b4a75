//! u-blox receivers: UBX-NAV-PVT.
//!
//! A frame consists of 0xB5 0x62, class, id, a two-byte length, the payload and a two-byte Fletcher
//! checksum. A 92-byte NAV-PVT, which receivers send since u-blox 8, yields a fix:
//!
//! - `velN`, `velE`, `velD` give the velocity east, north, up.
//! - `sAcc` gives the standard deviation. It is at least [`crate::ASSUMED_VERTICAL_SD_M_S`] for a
//!   two-dimensional fix, whose vertical velocity is assumed.
//! - `lat`, `lon`, `hMSL` give the position unless marked invalid.
//! - Date and time give the UNIX time if both are valid.
//!
//! A message yields a fix only if `gnssFixOK` is set. Other frames are counted. NMEA and RTCM
//! between the frames count as skipped bytes.

use ublox::{
    GnssFixType, UbxProtocol,
    nav_pvt::{
        common::{NavPvtFlags, NavPvtValidFlags},
        proto23::NavPvtRef,
    },
    proto23::{PacketRef, Proto23},
};

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
const PVT_LENGTHS_BYTES: [usize; 2] = [84, 92];

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
        if is_pvt && let Ok(PacketRef::NavPvt(pvt)) = Proto23::match_packet(class, id, &covered[HEADER_BYTES..]) {
            measurements.extend(fix(&pvt));
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

fn fix(pvt: &NavPvtRef<'_>) -> Option<Measurement> {
    let min_sd_m_s = match pvt.fix_type() {
        GnssFixType::Fix3D | GnssFixType::GPSPlusDeadReckoning => 0.0,
        GnssFixType::Fix2D => ASSUMED_VERTICAL_SD_M_S,
        _ => return None,
    };
    if !pvt.flags().contains(NavPvtFlags::GPS_FIX_OK) {
        return None;
    }
    let value = Value::Fix {
        velocity_m_s: [pvt.vel_east(), pvt.vel_north(), -pvt.vel_down()],
        sd_m_s: Some(pvt.speed_accuracy().max(min_sd_m_s)),
        position: if pvt.flags3().invalid_llh() {
            Position::default()
        } else {
            Position::from_degrees(pvt.latitude(), pvt.longitude(), pvt.height_msl())
        },
    };
    Some(Measurement { time: unix_time(pvt), value })
}

fn unix_time(pvt: &NavPvtRef<'_>) -> Option<DeviceTime> {
    if !pvt.valid().contains(NavPvtValidFlags::VALID_DATE | NavPvtValidFlags::VALID_TIME) {
        return None;
    }
    let date = chrono::NaiveDate::from_ymd_opt(pvt.year().into(), pvt.month().into(), pvt.day().into())?;
    let midnight_s = date.and_hms_opt(0, 0, 0)?.and_utc().timestamp();
    // The time is computed arithmetically, because the seconds may be 60 in a leap second and the
    // nanoseconds may be negative.
    let now_s = midnight_s + (i64::from(pvt.hour()) * 60 + i64::from(pvt.min())) * 60 + i64::from(pvt.sec());
    let now_ns = now_s.checked_mul(1_000_000_000)?.checked_add(pvt.nanosec().into())?;
    Some(DeviceTime::Unix { now_ns: u64::try_from(now_ns).ok()? })
}
