//! North reference of the course: `north`, `position` and `date` in `[course]`.

use serde::{Deserialize, Serialize};
use std::fmt;

use crate::{
    keys::keys,
    kind::{Day, Optional, Table, one_of},
    toml_reader::Section,
};

/// Years covered by the built-in coefficients of the World Magnetic Model.
pub const MODEL_YEARS: std::ops::RangeInclusive<u16> = 2020..=2029;

keys! {
    /// North reference of the course for stages that output a magnetic course.
    #[derive(Copy)]
    pub struct NorthReference {
        /// North to which the course refers. "true" converts a magnetic course with the World
        /// Magnetic Model at the latest fix, see docs/reference/choosing-a-stage.md.
        is_true as "north": bool = false, one_of([("magnetic", false), ("true", true)]);
        /// Position used until the first fix, WGS 84.
        position: Option<Position> = None, Optional(Table(Position::read));
        /// Date for the World Magnetic Model. If not set, live sensors use the day of the start.
        date: Option<Date> = None, Day { expected: expected_date(), parse: Date::new }, example "2026-11-23";
    }
}

fn expected_date() -> String {
    format!("a date from {} to {}, such as 2026-11-23", MODEL_YEARS.start(), MODEL_YEARS.end())
}

keys! {
    /// Position on the Earth, WGS 84.
    #[derive(Copy)]
    pub struct Position {
        /// Geodetic latitude, north positive.
        latitude_deg: f64 = 0.0, -90.0..=90.0, unit "°", example "55.75";
        /// Longitude, east positive.
        longitude_deg: f64 = 0.0, -180.0..=180.0, unit "°", example "37.62";
        /// Altitude above the ellipsoid or sea level. Either may be used, because the difference
        /// between them does not affect the declination.
        altitude_m: f64 = 0.0, -1000.0..=850_000.0, unit "m", example "150";
    }
}

impl Position {
    fn read(&mut self, section: &mut Section<'_, '_>) {
        self.read_keys(section);
        if section.missing(&["latitude_deg", "longitude_deg"]).is_some() {
            section.report_table("course.position: needs both latitude_deg and longitude_deg", "one is missing");
        }
    }
}

/// Calendar date, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Date {
    /// Year, within [`MODEL_YEARS`].
    pub year: u16,
    /// Month, 1 to 12.
    pub month: u8,
    /// Day of the month, from 1.
    pub day: u8,
}

impl Date {
    /// Creates a date. Returns `None` if there is no such date or it is outside [`MODEL_YEARS`].
    pub fn new(year: u16, month: u8, day: u8) -> Option<Self> {
        let is_leap_year = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
        let days = match month {
            2 => 28 + u8::from(is_leap_year),
            4 | 6 | 9 | 11 => 30,
            1..=12 => 31,
            _ => return None,
        };
        (MODEL_YEARS.contains(&year) && (1..=days).contains(&day)).then_some(Self { year, month, day })
    }

    /// Returns the date as a decimal number: 20261123 for 23 November 2026.
    pub fn number(self) -> u32 {
        u32::from(self.year) * 10_000 + u32::from(self.month) * 100 + u32::from(self.day)
    }

    /// Converts a number from [`Date::number`] back to a date, or returns `None` if it is invalid.
    pub fn from_number(number: u32) -> Option<Self> {
        let (year, month, day) = (number / 10_000, number / 100 % 100, number % 100);
        Self::new(year.try_into().ok()?, month.try_into().ok()?, day.try_into().ok()?)
    }
}

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { year, month, day } = self;
        write!(f, "{year:04}-{month:02}-{day:02}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    #[test]
    fn north_position_and_date_are_read() {
        assert_eq!(Launch::parse("x", "").unwrap().north, NorthReference::default());
        let text = "[course]\nnorth = \"true\"\ndate = 2026-02-28\nposition = { latitude_deg = 55.75, longitude_deg = -37, altitude_m = 150 }";
        let expected = NorthReference {
            is_true: true,
            position: Some(Position { latitude_deg: 55.75, longitude_deg: -37.0, altitude_m: 150.0 }),
            date: Some(Date { year: 2026, month: 2, day: 28 }),
        };
        assert_eq!(Launch::parse("x", text).unwrap().north, expected);
        assert_eq!(Launch::parse("x", "course.date = \"2028-02-29\"").unwrap().north.date, Date::new(2028, 2, 29));
    }

    #[test]
    fn date_survives_conversion_to_number() {
        let date = Date::new(2026, 11, 3).unwrap();
        assert_eq!((date.number(), date.to_string().as_str()), (20_261_103, "2026-11-03"));
        assert_eq!(Date::from_number(date.number()), Some(date));
        for invalid in [0, 20_261_131, 20_260_229, 20_191_231, 20_300_101, 20_261_301, u32::MAX] {
            assert_eq!(Date::from_number(invalid), None, "{invalid}");
        }
    }

    #[test]
    fn invalid_date_or_position_is_rejected() {
        for (text, expected) in [
            ("course.north = \"tru\"", "did you mean \"true\"?"),
            (
                "course.date = 2031-01-01",
                "course.date: expected a date from 2020 to 2029, such as 2026-11-23, found 2031-01-01",
            ),
            ("course.date = 2026-11-23T10:00:00Z", "expected a date from 2020 to 2029"),
            ("course.date = \"2026-02-29\"", "expected a date from 2020 to 2029"),
            ("course.date = 2026", "expected a date from 2020 to 2029"),
            ("course.position = { latitude_deg = 91, longitude_deg = 0 }", "expected -90 to 90, found 91"),
            ("course.position.latitude_deg = 1", "needs both latitude_deg and longitude_deg"),
        ] {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(shown.contains(expected) && shown.ends_with("1 problem"), "{expected}:\n{shown}");
        }
    }
}
