//! Receivers that speak NMEA 0183: RMC and VTG.
//!
//! A sentence is `$`, five letters, fields with commas between them, `*` and the exclusive or of all between in two hexadecimal digits.
//! RMC becomes a fix: speed over ground and course as velocity east and north, latitude, longitude, date and time as time since 1970. VTG does
//! as long as no RMC came: it has the same speed and course, and neither time nor place. Other sentences are counted.
//!
//! **The vertical velocity is in neither.** It is given as 0 with a standard deviation of [`crate::VERTICAL_SD_M_S`] for all three
//! components, which suits what moves on ground and water; what climbs needs a receiver that tells it, as UBX does.
//!
//! A fix is none when the sentence says so: status V, or a mode that is estimated, manual, simulated or invalid. A receiver that stands
//! leaves the course away: below [`STANDING_M_S`] the velocity is then 0, above it there is no fix.

use crate::{
    DeviceTime, Measurement, Place, VERTICAL_SD_M_S, Value,
    framed::{Format, Seen},
};

/// Between `$` and `*`; the standard has 79, receivers exceed it a little.
const LENGTH_MAX_BYTES: usize = 128;
const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;
/// A speed that needs no course, m/s.
pub const STANDING_M_S: f64 = 0.5;
/// Years of two digits from here on are of the century before.
const YEAR_TURNS: u32 = 80;

/// Whether an RMC came.
#[derive(Debug, Clone, Copy, Default)]
pub struct Nmea {
    has_rmc: bool,
}

impl Format for Nmea {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        let Some((b'$', rest)) = bytes.split_first() else { return Seen::Nothing(1) };
        let is_inside = |byte: &u8| matches!(byte, b' '..=b'~') && !matches!(byte, b'$' | b'*');
        let window = &rest[..rest.len().min(LENGTH_MAX_BYTES + 1)];
        let Some(length) = window.iter().position(|byte| !is_inside(byte)) else {
            return if rest.len() > LENGTH_MAX_BYTES { Seen::Refused } else { Seen::More };
        };
        let (inside, end) = rest.split_at(length);
        let checksum = match *end {
            [b'*'] => return Seen::More,
            [b'*', high] if high.is_ascii_hexdigit() => return Seen::More,
            [b'*', high, low, ..] => hexadecimal(high).zip(hexadecimal(low)).map(|(high, low)| high << 4 | low),
            _ => None,
        };
        if checksum != Some(inside.iter().fold(0, |sum, byte| sum ^ byte)) {
            return Seen::Refused;
        }
        found.extend(str::from_utf8(inside).ok().and_then(|sentence| self.fix(sentence)));
        Seen::Frame(1 + length + 3)
    }
}

fn hexadecimal(digit: u8) -> Option<u8> {
    u8::try_from(char::from(digit).to_digit(16)?).ok()
}

impl Nmea {
    fn fix(&mut self, sentence: &str) -> Option<Measurement> {
        let (address, fields) = sentence.split_once(',')?;
        let fields = Fields(fields);
        match address.get(2..)? {
            "RMC" => {
                self.has_rmc = true;
                let (time, status, mode) = (fields.nth(0), fields.nth(1), fields.nth(11));
                let value = (status == "A" && is_measured(mode)).then(|| fields.velocity(6, 7, fields.place(2)))??;
                Some(Measurement { time: unix(fields.nth(8), time), value })
            }
            "VTG" if !self.has_rmc && is_measured(fields.nth(8)) => {
                Some(Measurement { time: None, value: fields.velocity(4, 0, Place::default())? })
            }
            _ => None,
        }
    }
}

/// Autonomous, differential, precise, two kinds of real-time kinematic; before NMEA 2.3 nothing was said.
fn is_measured(mode: &str) -> bool {
    matches!(mode, "" | "A" | "D" | "P" | "R" | "F")
}

#[derive(Clone, Copy)]
struct Fields<'a>(&'a str);

impl<'a> Fields<'a> {
    /// Nothing beyond the last.
    fn nth(&self, index: usize) -> &'a str {
        self.0.split(',').nth(index).unwrap_or_default()
    }

    /// Blank is `Ok(None)`.
    fn number(&self, index: usize) -> Option<Option<f64>> {
        match self.nth(index) {
            "" => Some(None),
            text => Some(Some(decimal(text)?)),
        }
    }

    fn velocity(&self, knots: usize, course: usize, place: Place) -> Option<Value> {
        let speed_m_s = self.number(knots)?? * M_S_PER_KNOT;
        let (east, north) = match self.number(course)? {
            Some(course_deg) => course_deg.to_radians().sin_cos(),
            None if speed_m_s < STANDING_M_S => (0.0, 0.0),
            None => return None,
        };
        let velocity_m_s = [speed_m_s * east, speed_m_s * north, 0.0];
        Some(Value::Fix { velocity_m_s, sd_m_s: Some(VERTICAL_SD_M_S), place })
    }

    /// Latitude, N or S, longitude, E or W.
    fn place(&self, index: usize) -> Place {
        let told = |angle_deg: Option<f64>| angle_deg.unwrap_or(f64::NAN);
        Place::of(told(self.degrees(index, "N", "S")), told(self.degrees(index + 2, "E", "W")), f64::NAN)
    }

    /// Degrees and minutes, `dddmm.mm`, then a letter.
    fn degrees(&self, index: usize, positive: &str, negative: &str) -> Option<f64> {
        let together = decimal(self.nth(index))?;
        let degrees = (together / 100.0).floor();
        let angle_deg = degrees + (together - degrees * 100.0) / 60.0;
        match self.nth(index + 1) {
            letter if letter == positive => Some(angle_deg),
            letter if letter == negative => Some(-angle_deg),
            _ => None,
        }
    }
}

/// A number without a sign or an exponent.
fn decimal(text: &str) -> Option<f64> {
    let is_plain = text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    text.parse().ok().filter(|_| is_plain)
}

/// Of `ddmmyy` and `hhmmss.sss`.
fn unix(date: &str, time: &str) -> Option<DeviceTime> {
    let pair = |text: &str, at: usize| -> Option<u32> {
        let pair = text.get(at..at + 2).filter(|pair| pair.bytes().all(|byte| byte.is_ascii_digit()))?;
        pair.parse().ok()
    };
    let year = pair(date, 4).filter(|_| date.len() == 6)?;
    let year = if year < YEAR_TURNS { 2000 + year } else { 1900 + year };
    let date = chrono::NaiveDate::from_ymd_opt(year.try_into().ok()?, pair(date, 2)?, pair(date, 0)?)?;
    let midnight_s = date.and_hms_opt(0, 0, 0)?.and_utc().timestamp();
    let minutes = pair(time, 0).filter(|hour| *hour < 24)? * 60 + pair(time, 2).filter(|minute| *minute < 60)?;
    let seconds_ns = mapping::text::time_ns(time.get(4..)?, 9).filter(|ns| (0..61_000_000_000).contains(ns))?;
    let now_ns = (midnight_s + i64::from(minutes) * 60).checked_mul(1_000_000_000)?.checked_add(seconds_ns)?;
    Some(DeviceTime::Unix { now_ns: u64::try_from(now_ns).ok()? })
}
