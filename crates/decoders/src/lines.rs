//! Lines of numbers: `t,gx,gy,gz,ax,ay,az`, as a microcontroller prints them, or a recording of ours sent over a line.
//!
//! Which column is what, its unit and its axes, is a [`Mapping`], with the same words as `plumb import`. The columns are named in the
//! settings or by a line of the stream that has all their names, at its beginning or later; a recording's `t_s` is a time in s. A line
//! ends with a newline; its numbers are separated by tabs, semicolons, commas or blanks, and have a decimal point, or a decimal comma
//! where the separator is another. Lines that begin with `#`, and blank ones, are counted and tell nothing.
//!
//! | column | what |
//! | --- | --- |
//! | `gx`, `gy`, `gz`; `ax`, `ay`, `az` | rate and force; they must be among the columns. Blank or `nan` is handed on as NaN; a line without any of the six has none |
//! | `mx`, `my`, `mz` | field, in the lines where all three are numbers |
//! | `ve`, `vn`, `vu` or `vd`, `lat`, `lon`, `alt` | a fix, in the lines where the velocity is there and is not the one before it again |
//! | `t` | the time: from 1970 if it is beyond 2001-09-09, else since the device's start, before which it is a two's complement; a counter that begins again if it is said to be |
//! | others | passed over |
//!
//! Lines of 7 or 10 numbers that nobody named are `t,gx,gy,gz,ax,ay,az` and, with three more, `mx,my,mz`.
//!
//! The first line after the beginning may be the end of one, with digits missing: it is taken if it names columns, or if streams are
//! said to begin with a whole one; else it is passed over.
//! Limits: there is no checksum. A line with anything that is not text, a number that is none, or another count of fields is refused as
//! a whole; a digit that the line changed into another one is not seen.

use std::borrow::Cow;

use mapping::{
    FIELD, FORCE, Mapping, POSITION, RATE,
    names::nearest,
    text::{fields, time_ns},
};

use crate::{
    DeviceTime, Measurement, Place, Value,
    framed::{Format, Seen},
};

/// With its newline.
const LINE_MAX_BYTES: usize = 4096;
const SEPARATORS: [u8; 3] = [b'\t', b';', b','];
/// A time from here on counts from 1970, ns: 2001-09-09.
const UNIX_FROM_NS: i64 = 1_000_000_000_000_000_000;
/// Columns that nobody named, by how many they are.
const UNNAMED: [&str; 10] = ["t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz"];
const UNNAMED_COUNTS: [usize; 2] = [7, 10];
/// What a recording of ours calls `t`.
const TIME_OF_A_RECORDING: &str = "t_s";

/// Columns, and where they are.
#[derive(Debug, Clone)]
pub struct Lines {
    mapping: Mapping,
    /// Of the counter that the time is.
    period_ns: Option<u64>,
    places: Option<Places>,
    is_begun: bool,
    last_fix: Option<[u64; 6]>,
}

/// What lines are made of.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    /// Which column is what.
    pub mapping: Mapping,
    /// The names of the columns, in their order; `None` where a line of the stream names them.
    pub columns: Option<Vec<String>>,
    /// The time is a whole number of so many bits, 1 to 63, and begins again after the largest: 32 for `micros()` of an Arduino.
    pub time_bits: Option<u8>,
    /// The first line is whole, as that of a program or a datagram is, and not that of a serial line that is in the middle of one.
    pub begins_whole: bool,
}

/// What is wrong with settings.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum LinesError {
    /// A column that is not named.
    #[error("reading the columns: there is no {column:?} for {target}{}", near.as_ref().map_or_else(String::new, |near| format!(", did you mean {near:?}?")))]
    NoColumn {
        /// What it is mapped to.
        target: &'static str,
        /// Its name.
        column: String,
        /// A column of nearly that name.
        near: Option<String>,
    },
    /// A counter of so many bits is none.
    #[error(
        "reading the bits of the time: found {bits}, expected 1 to 63, and a counter that begins again within 292 years"
    )]
    Bits {
        /// What is there.
        bits: u8,
    },
}

impl Lines {
    /// What `settings` say.
    pub fn new(settings: &Settings) -> Result<Self, LinesError> {
        let mapping = settings.mapping.clone();
        let period_ns = settings
            .time_bits
            .map(|bits| mapping.period_ns(bits.into()).ok_or(LinesError::Bits { bits }))
            .transpose()?;
        let named = settings.columns.as_ref().map(|columns| {
            let columns: Vec<_> = columns.iter().map(|column| column.trim()).collect();
            Places::of(&mapping, &columns).map_err(|target| {
                let column = mapping.column(target).unwrap_or(target);
                let near = nearest(column, columns.iter().copied()).map(str::to_owned);
                LinesError::NoColumn { target, column: column.to_owned(), near }
            })
        });
        let places = named.transpose()?;
        Ok(Self { mapping, period_ns, places, is_begun: settings.begins_whole, last_fix: None })
    }

    fn line(&mut self, line: &[u8], found: &mut Vec<Measurement>) -> Option<()> {
        let is_text = line.iter().all(|byte| matches!(byte, b' '..=b'~' | b'\t' | b'\r'));
        let line = str::from_utf8(line).ok().filter(|_| is_text)?.trim_ascii();
        if line.is_empty() || line.starts_with('#') {
            return Some(());
        }
        let separator = SEPARATORS.into_iter().find(|separator| line.as_bytes().contains(separator));
        let fields: Vec<&str> = match separator {
            Some(separator) => {
                fields(line.as_bytes(), separator).map(|field| str::from_utf8(field).unwrap_or_default()).collect()
            }
            None => line.split_ascii_whitespace().collect(),
        };
        let row = Row { fields: &fields, has_comma: separator != Some(b',') };
        if self.is_begun && self.row(&row, found).is_some() {
            return Some(());
        }
        if let Ok(places) = Places::of(&self.mapping, &fields) {
            self.places = Some(places);
            return Some(());
        }
        if !self.is_begun || self.places.is_some() || self.mapping.is_said() {
            return None;
        }
        let unnamed = UNNAMED.get(..fields.len()).filter(|names| UNNAMED_COUNTS.contains(&names.len()))?;
        self.places = Places::of(&self.mapping, unnamed).ok();
        let row = self.row(&row, found);
        if row.is_none() {
            self.places = None;
        }
        row
    }

    fn row(&mut self, row: &Row<'_>, found: &mut Vec<Measurement>) -> Option<()> {
        let places = self.places.as_ref().filter(|places| places.count == row.fields.len())?;
        let time = match places.time {
            Some(index) => self.time(row.fields[index], row)?,
            None => None,
        };
        let (rate, force) = (row.numbers(places.rate)?, row.numbers(places.force)?);
        let (field, velocity) = (row.whole(places.field)?, row.whole(places.velocity)?);
        let mut place = [f64::NAN; 3];
        for (part, index) in place.iter_mut().zip(places.position) {
            *part = index.map_or(Some(f64::NAN), |index| row.number(index))?;
        }
        if let Some(velocity) = velocity {
            let ([east, north, up], [latitude_deg, longitude_deg, altitude_m]) = (velocity, place);
            let said = [east, north, up, latitude_deg, longitude_deg, altitude_m].map(f64::to_bits);
            if self.last_fix.replace(said) != Some(said) {
                let place = Place::of(latitude_deg, longitude_deg, altitude_m);
                let velocity_m_s = self.mapping.velocity_m_s(velocity);
                found.push(Measurement { time, value: Value::Fix { velocity_m_s, sd_m_s: None, place } });
            }
        }
        if !rate.iter().chain(&force).all(|number| number.is_nan()) {
            let value = Value::Imu {
                rate_rad_s: self.mapping.rate_rad_s(rate),
                force_m_s2: self.mapping.force_m_s2(force),
                field_ut: field.map(|field| self.mapping.field_ut(field)),
            };
            found.push(Measurement { time, value });
        } else if let Some(field) = field {
            found.push(Measurement { time, value: Value::Field(self.mapping.field_ut(field)) });
        }
        Some(())
    }

    /// `Some(None)` of a blank one; `None` of what is no time.
    fn time(&self, text: &str, row: &Row<'_>) -> Option<Option<DeviceTime>> {
        let text = row.pointed(text);
        if text.is_empty() {
            return Some(None);
        }
        let t_ns = time_ns(&text, self.mapping.time_digits())?;
        // A recording may begin before its 0: such a time comes out as it went in.
        let now_ns = t_ns.cast_unsigned();
        Some(Some(match self.period_ns {
            Some(_) if t_ns < 0 => return None,
            Some(period_ns) => DeviceTime::Counter { now_ns: now_ns % period_ns, period_ns },
            None if t_ns >= UNIX_FROM_NS => DeviceTime::Unix { now_ns },
            None => DeviceTime::SinceBoot { now_ns },
        }))
    }
}

impl Format for Lines {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        let window = &bytes[..bytes.len().min(LINE_MAX_BYTES)];
        let Some(end) = window.iter().position(|byte| *byte == b'\n') else {
            if bytes.len() < LINE_MAX_BYTES {
                return Seen::More;
            }
            // What follows up to the next newline is the end of this.
            self.is_begun = false;
            return Seen::Nothing(LINE_MAX_BYTES);
        };
        let is_line = self.line(&bytes[..end], found).is_some();
        match (is_line, std::mem::replace(&mut self.is_begun, true)) {
            (true, _) => Seen::Frame(end + 1),
            (false, true) => Seen::RefusedLine(end + 1),
            (false, false) => Seen::Nothing(end + 1),
        }
    }
}

/// A line, taken apart.
struct Row<'a> {
    fields: &'a [&'a str],
    /// A comma does not separate: it may be a decimal one.
    has_comma: bool,
}

impl Row<'_> {
    /// Of fields that are there; blank is NaN.
    fn numbers(&self, indices: [usize; 3]) -> Option<[f64; 3]> {
        let [x, y, z] = indices.map(|index| self.number(index));
        Some([x?, y?, z?])
    }

    fn number(&self, index: usize) -> Option<f64> {
        let text = self.pointed(self.fields.get(index)?);
        if text.is_empty() { Some(f64::NAN) } else { text.parse().ok() }
    }

    /// `Some(None)` where one of them is no number.
    fn whole(&self, indices: Option<[usize; 3]>) -> Option<Option<[f64; 3]>> {
        let Some(indices) = indices else { return Some(None) };
        let numbers = self.numbers(indices)?;
        Some(numbers.iter().all(|number| number.is_finite()).then_some(numbers))
    }

    /// With a decimal point.
    fn pointed<'a>(&self, text: &'a str) -> Cow<'a, str> {
        if self.has_comma && text.contains(',') { text.replacen(',', ".", 1).into() } else { text.into() }
    }
}

/// Where columns are.
#[derive(Debug, Clone)]
struct Places {
    count: usize,
    time: Option<usize>,
    rate: [usize; 3],
    force: [usize; 3],
    field: Option<[usize; 3]>,
    velocity: Option<[usize; 3]>,
    position: [Option<usize>; 3],
}

impl Places {
    /// The target whose column is not there, where one is missing that must be.
    fn of(mapping: &Mapping, names: &[&str]) -> Result<Self, &'static str> {
        let place = |target: &'static str| -> Result<usize, &'static str> {
            let column = mapping.column(target).unwrap_or(target);
            let is_it = |name: &&str| {
                *name == column || (column == "t" && *name == TIME_OF_A_RECORDING && mapping.time_digits() == 9)
            };
            names.iter().position(is_it).ok_or(target)
        };
        let three = |[x, y, z]: [&'static str; 3]| Ok([place(x)?, place(y)?, place(z)?]);
        let [latitude, longitude, altitude] = POSITION;
        let one = |target| if mapping.column(target).is_some() { may_be(mapping, place(target)) } else { Ok(None) };
        let group = |targets| may_be(mapping, three(targets));
        Ok(Self {
            count: names.len(),
            time: one("t")?,
            rate: three(RATE)?,
            force: three(FORCE)?,
            field: if mapping.has_field() { group(FIELD)? } else { None },
            velocity: mapping.velocity().map_or(Ok(None), group)?,
            position: [one(latitude)?, one(longitude)?, one(altitude)?],
        })
    }
}

/// What somebody named must be there; what is called as what it is, may be.
fn may_be<T>(mapping: &Mapping, found: Result<T, &'static str>) -> Result<Option<T>, &'static str> {
    match found {
        Err(target) if mapping.is_said() => Err(target),
        found => Ok(found.ok()),
    }
}
