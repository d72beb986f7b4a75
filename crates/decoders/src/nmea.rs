//! NMEA 0183 receivers: RMC and VTG.
//!
//! A sentence consists of `$`, five letters, comma-separated fields, `*`, and the exclusive or of
//! the characters between `$` and `*` as two hexadecimal digits. RMC yields a fix: ground speed and
//! course as velocity east and north, latitude, longitude, and UNIX time. VTG yields a fix without
//! time and position, and only until the first RMC. Other sentences are counted.
//!
//! **Neither sentence has a vertical velocity.** The vertical velocity is set to 0, and all three
//! components get the standard deviation [`crate::ASSUMED_VERTICAL_SD_M_S`]. This suits ground
//! vehicles and boats. An aircraft needs a receiver that reports the vertical velocity, for example
//! over UBX.
//!
//! Sentences with status V or with an estimated, manual, simulated or invalid mode yield no fix. A
//! stationary receiver leaves the course field empty. Such a sentence yields velocity 0 if its
//! speed is below [`STATIONARY_SPEED_M_S`], otherwise no fix.

use crate::{
    ASSUMED_VERTICAL_SD_M_S, DeviceTime, Measurement, Position, Value,
    framed::{Format, ParseOutcome},
};

/// Maximum length between `$` and `*`. The standard allows 79 bytes, but some receivers send
/// slightly more.
const MAX_SENTENCE_BYTES: usize = 128;
const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;
/// Speed below which a fix needs no course, m/s.
pub const STATIONARY_SPEED_M_S: f64 = 0.5;
/// First two-digit year that belongs to the 20th century.
const CENTURY_PIVOT: u32 = 80;

/// NMEA format. Stores whether an RMC sentence has been received.
#[derive(Debug, Clone, Copy, Default)]
pub struct Nmea {
    has_rmc: bool,
}

impl Format for Nmea {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        let Some((b'$', rest)) = bytes.split_first() else { return ParseOutcome::Skip(1) };
        let is_inside = |byte: &u8| matches!(byte, b' '..=b'~') && !matches!(byte, b'$' | b'*');
        let window = &rest[..rest.len().min(MAX_SENTENCE_BYTES + 1)];
        let Some(length) = window.iter().position(|byte| !is_inside(byte)) else {
            return if rest.len() > MAX_SENTENCE_BYTES { ParseOutcome::Rejected } else { ParseOutcome::Incomplete };
        };
        let (inside, end) = rest.split_at(length);
        let checksum = match *end {
            [b'*'] => return ParseOutcome::Incomplete,
            [b'*', high] if high.is_ascii_hexdigit() => return ParseOutcome::Incomplete,
            [b'*', high, low, ..] => hex_digit(high).zip(hex_digit(low)).map(|(high, low)| high << 4 | low),
            _ => None,
        };
        if checksum != Some(inside.iter().fold(0, |sum, byte| sum ^ byte)) {
            return ParseOutcome::Rejected;
        }
        measurements.extend(str::from_utf8(inside).ok().and_then(|sentence| self.fix(sentence)));
        ParseOutcome::Frame(1 + length + 3)
    }
}

fn hex_digit(digit: u8) -> Option<u8> {
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
                let value =
                    (status == "A" && is_measured(mode)).then(|| fields.velocity(6, 7, fields.position(2)))??;
                Some(Measurement { time: unix_time(fields.nth(8), time), value })
            }
            "VTG" if !self.has_rmc && is_measured(fields.nth(8)) => {
                Some(Measurement { time: None, value: fields.velocity(4, 0, Position::default())? })
            }
            _ => None,
        }
    }
}

/// Returns `true` if the mode is autonomous, differential, precise or real-time kinematic, or
/// empty. Sentences before NMEA 2.3 have no mode.
fn is_measured(mode: &str) -> bool {
    matches!(mode, "" | "A" | "D" | "P" | "R" | "F")
}

#[derive(Clone, Copy)]
struct Fields<'a>(&'a str);

impl<'a> Fields<'a> {
    /// Returns the field at `index`, or an empty string if the sentence has fewer fields.
    fn nth(&self, index: usize) -> &'a str {
        self.0.split(',').nth(index).unwrap_or_default()
    }

    /// Parses the field at `index` as a number. An empty field yields `Some(None)`, an invalid one
    /// `None`.
    fn number(&self, index: usize) -> Option<Option<f64>> {
        match self.nth(index) {
            "" => Some(None),
            text => Some(Some(decimal(text)?)),
        }
    }

    fn velocity(&self, knots_index: usize, course_index: usize, position: Position) -> Option<Value> {
        let speed_m_s = self.number(knots_index)?? * M_S_PER_KNOT;
        let (east, north) = match self.number(course_index)? {
            Some(course_deg) => course_deg.to_radians().sin_cos(),
            None if speed_m_s < STATIONARY_SPEED_M_S => (0.0, 0.0),
            None => return None,
        };
        let velocity_m_s = [speed_m_s * east, speed_m_s * north, 0.0];
        Some(Value::Fix { velocity_m_s, sd_m_s: Some(ASSUMED_VERTICAL_SD_M_S), position })
    }

    /// Returns the position from the four fields that start at `index`: latitude, N or S,
    /// longitude, E or W.
    fn position(&self, index: usize) -> Position {
        let or_nan = |angle_deg: Option<f64>| angle_deg.unwrap_or(f64::NAN);
        Position::from_degrees(
            or_nan(self.degrees(index, "N", "S")),
            or_nan(self.degrees(index + 2, "E", "W")),
            f64::NAN,
        )
    }

    /// Returns the signed angle in degrees, given as `dddmm.mm` and a hemisphere letter in the next
    /// field.
    fn degrees(&self, index: usize, positive: &str, negative: &str) -> Option<f64> {
        let packed = decimal(self.nth(index))?;
        let degrees = (packed / 100.0).floor();
        let angle_deg = degrees + (packed - degrees * 100.0) / 60.0;
        match self.nth(index + 1) {
            letter if letter == positive => Some(angle_deg),
            letter if letter == negative => Some(-angle_deg),
            _ => None,
        }
    }
}

/// Parses a number without sign or exponent.
fn decimal(text: &str) -> Option<f64> {
    let is_plain = text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    text.parse().ok().filter(|_| is_plain)
}

/// Returns the timestamp given by a date `ddmmyy` and a time `hhmmss.sss`.
fn unix_time(date: &str, time: &str) -> Option<DeviceTime> {
    let pair = |text: &str, at: usize| -> Option<u32> {
        let pair = text.get(at..at + 2).filter(|pair| pair.bytes().all(|byte| byte.is_ascii_digit()))?;
        pair.parse().ok()
    };
    let year = pair(date, 4).filter(|_| date.len() == 6)?;
    let year = if year < CENTURY_PIVOT { 2000 + year } else { 1900 + year };
    let date = chrono::NaiveDate::from_ymd_opt(year.try_into().ok()?, pair(date, 2)?, pair(date, 0)?)?;
    let midnight_s = date.and_hms_opt(0, 0, 0)?.and_utc().timestamp();
    let minutes = pair(time, 0).filter(|hour| *hour < 24)? * 60 + pair(time, 2).filter(|minute| *minute < 60)?;
    let seconds_ns = mapping::text::time_ns(time.get(4..)?, 9).filter(|ns| (0..61_000_000_000).contains(ns))?;
    let now_ns = (midnight_s + i64::from(minutes) * 60).checked_mul(1_000_000_000)?.checked_add(seconds_ns)?;
    Some(DeviceTime::Unix { now_ns: u64::try_from(now_ns).ok()? })
}
