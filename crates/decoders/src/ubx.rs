//! u-blox receivers: UBX-NAV-PVT.
//!
//! A frame is 0xB5 0x62, class, id, a length of two bytes, payload, and two sums (Fletcher's). NAV-PVT in its form of 92 bytes, which
//! receivers from u-blox 8 on send, becomes a fix: `velN`, `velE`, `velD` as velocity east, north, up; `sAcc` as standard deviation;
//! `lat`, `lon`, `hMSL`, unless they are said to be invalid; date and time as time since 1970, if both are valid. A fix in two dimensions, whose vertical
//! velocity is assumed, has a standard deviation of [`crate::VERTICAL_SD_M_S`] or more. Without `gnssFixOK` there is no fix. Other
//! frames are counted; NMEA and RTCM between them are bytes of no frame.

use ublox::{
    GnssFixType, UbxProtocol,
    nav_pvt::{
        common::{NavPvtFlags, NavPvtValidFlags},
        proto23::NavPvtRef,
    },
    proto23::{PacketRef, Proto23},
};

use crate::{
    DeviceTime, Measurement, Place, VERTICAL_SD_M_S, Value,
    framed::{Format, Seen},
};

const BEGIN: u8 = 0xb5;
const BEGIN_2: u8 = 0x62;
const HEAD_BYTES: usize = 6;
const CHECKSUM_BYTES: usize = 2;
/// Of a payload; the longest that receivers send regularly are raw measurements of a hundred signals.
const LENGTH_MAX_BYTES: usize = 4096;
const CLASS_NAV: u8 = 0x01;
const ID_PVT: u8 = 0x07;
/// Of a payload of NAV-PVT, before u-blox 8 and since. Another one is a length that the line changed: to wait for its end would be to
/// hold the next fixes back.
const PVT_LENGTHS_BYTES: [usize; 2] = [84, 92];

/// Has no settings.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ubx;

impl Format for Ubx {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        match bytes {
            [BEGIN] => return Seen::More,
            [BEGIN, BEGIN_2, ..] => {}
            _ => return Seen::Nothing(1),
        }
        let Some(&[_, _, class, id, low, high]) = bytes.first_chunk::<HEAD_BYTES>() else { return Seen::More };
        let length = usize::from(u16::from_le_bytes([low, high]));
        let is_pvt = (class, id) == (CLASS_NAV, ID_PVT);
        if length > LENGTH_MAX_BYTES || (is_pvt && !PVT_LENGTHS_BYTES.contains(&length)) {
            return Seen::Refused;
        }
        let Some(frame) = bytes.get(..HEAD_BYTES + length + CHECKSUM_BYTES) else { return Seen::More };
        let (covered, checksum) = frame.split_at(HEAD_BYTES + length);
        if fletcher(&covered[2..]) != checksum {
            return Seen::Refused;
        }
        if is_pvt && let Ok(PacketRef::NavPvt(said)) = Proto23::match_packet(class, id, &covered[HEAD_BYTES..]) {
            found.extend(fix(&said));
        }
        Seen::Frame(frame.len())
    }
}

fn fletcher(bytes: &[u8]) -> [u8; 2] {
    bytes.iter().fold([0, 0], |[a, b]: [u8; 2], byte| {
        let a = a.wrapping_add(*byte);
        [a, b.wrapping_add(a)]
    })
}

fn fix(said: &NavPvtRef<'_>) -> Option<Measurement> {
    let least_sd_m_s = match said.fix_type() {
        GnssFixType::Fix3D | GnssFixType::GPSPlusDeadReckoning => 0.0,
        GnssFixType::Fix2D => VERTICAL_SD_M_S,
        _ => return None,
    };
    if !said.flags().contains(NavPvtFlags::GPS_FIX_OK) {
        return None;
    }
    let value = Value::Fix {
        velocity_m_s: [said.vel_east(), said.vel_north(), -said.vel_down()],
        sd_m_s: Some(said.speed_accuracy().max(least_sd_m_s)),
        place: if said.flags3().invalid_llh() {
            Place::default()
        } else {
            Place::of(said.latitude(), said.longitude(), said.height_msl())
        },
    };
    Some(Measurement { time: unix(said), value })
}

fn unix(said: &NavPvtRef<'_>) -> Option<DeviceTime> {
    if !said.valid().contains(NavPvtValidFlags::VALID_DATE | NavPvtValidFlags::VALID_TIME) {
        return None;
    }
    let date = chrono::NaiveDate::from_ymd_opt(said.year().into(), said.month().into(), said.day().into())?;
    let midnight_s = date.and_hms_opt(0, 0, 0)?.and_utc().timestamp();
    // A leap second is the 60th; the part of a second may be negative.
    let now_s = midnight_s + (i64::from(said.hour()) * 60 + i64::from(said.min())) * 60 + i64::from(said.sec());
    let now_ns = now_s.checked_mul(1_000_000_000)?.checked_add(said.nanosec().into())?;
    Some(DeviceTime::Unix { now_ns: u64::try_from(now_ns).ok()? })
}
