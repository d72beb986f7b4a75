//! From which north a course is counted: `north`, `position` and `date` in `[course]`.

use serde::{Deserialize, Serialize};
use std::fmt;

use crate::walk::Section;

/// Years for which the World Magnetic Model's coefficients are here.
pub const MODEL_YEARS: std::ops::RangeInclusive<u16> = 2020..=2029;

/// From which north a course is counted that a stage counts from magnetic north.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct North {
    /// From true north, by the World Magnetic Model; else it stays as the stage gives it.
    pub is_true: bool,
    /// Where the vehicle is until a fix tells.
    pub position: Option<Position>,
    /// The model's date. What is started has one where `is_true`.
    pub date: Option<Date>,
}

/// A place on the earth, WGS 84.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Position {
    /// Geodetic, °, north positive.
    pub latitude_deg: f64,
    /// °, east positive.
    pub longitude_deg: f64,
    /// Above the ellipsoid or the sea, m: the difference moves no declination.
    pub altitude_m: f64,
}

/// A day, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Date {
    /// One of [`MODEL_YEARS`].
    pub year: u16,
    /// 1 to 12.
    pub month: u8,
    /// 1 to 31, as the month has days.
    pub day: u8,
}

impl Date {
    /// The day; `None` where it is none, or the model has no coefficients for it.
    pub fn new(year: u16, month: u8, day: u8) -> Option<Self> {
        let leap = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
        let days = match month {
            2 => 28 + u8::from(leap),
            4 | 6 | 9 | 11 => 30,
            1..=12 => 31,
            _ => return None,
        };
        (MODEL_YEARS.contains(&year) && (1..=days).contains(&day)).then_some(Self { year, month, day })
    }

    /// The day as one number: 20261123 for the 23rd of November 2026.
    pub fn number(self) -> u32 {
        u32::from(self.year) * 10_000 + u32::from(self.month) * 100 + u32::from(self.day)
    }

    /// The day of that number.
    pub fn of_number(number: u32) -> Option<Self> {
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

/// Reads the keys of `[course]` that are no stage's.
pub(crate) fn north(section: &mut Section<'_, '_>, out: &mut North) {
    section.choice("north", [("magnetic", false), ("true", true)], &mut out.is_true);
    section.section("position", |section| {
        let mut position = Position::default();
        section.number("latitude_deg", -90.0..=90.0, &mut position.latitude_deg);
        section.number("longitude_deg", -180.0..=180.0, &mut position.longitude_deg);
        section.number("altitude_m", -1000.0..=850_000.0, &mut position.altitude_m);
        if section.has("latitude_deg") && section.has("longitude_deg") {
            out.position = Some(position);
        } else {
            section.report_table("course.position: latitude_deg and longitude_deg go together", "one is missing");
        }
    });
    let expected = format!("a day of {} to {}, as 2026-11-23", MODEL_YEARS.start(), MODEL_YEARS.end());
    section.date("date", &expected, |(year, month, day)| Date::new(year, month, day), &mut out.date);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    #[test]
    fn north_position_and_date_are_taken() {
        assert_eq!(Launch::parse("x", "").unwrap().north, North::default());
        let text = "[course]\nnorth = \"true\"\ndate = 2026-02-28\nposition = { latitude_deg = 55.75, longitude_deg = -37, altitude_m = 150 }";
        let expected = North {
            is_true: true,
            position: Some(Position { latitude_deg: 55.75, longitude_deg: -37.0, altitude_m: 150.0 }),
            date: Some(Date { year: 2026, month: 2, day: 28 }),
        };
        assert_eq!(Launch::parse("x", text).unwrap().north, expected);
        assert_eq!(Launch::parse("x", "course.date = \"2028-02-29\"").unwrap().north.date, Date::new(2028, 2, 29));
    }

    #[test]
    fn a_day_is_the_same_by_its_number() {
        let date = Date::new(2026, 11, 3).unwrap();
        assert_eq!((date.number(), date.to_string().as_str()), (20_261_103, "2026-11-03"));
        assert_eq!(Date::of_number(date.number()), Some(date));
        for none in [0, 20_261_131, 20_260_229, 20_191_231, 20_300_101, 20_261_301, u32::MAX] {
            assert_eq!(Date::of_number(none), None, "{none}");
        }
    }

    #[test]
    fn what_is_no_day_or_no_place_is_pointed_at() {
        for (text, said) in [
            ("course.north = \"tru\"", "did you mean \"true\"?"),
            (
                "course.date = 2031-01-01",
                "course.date: expected a day of 2020 to 2029, as 2026-11-23, found 2031-01-01",
            ),
            ("course.date = 2026-11-23T10:00:00Z", "expected a day of 2020 to 2029"),
            ("course.date = \"2026-02-29\"", "expected a day of 2020 to 2029"),
            ("course.date = 2026", "expected a day of 2020 to 2029"),
            ("course.position = { latitude_deg = 91, longitude_deg = 0 }", "expected -90 to 90, found 91"),
            ("course.position.latitude_deg = 1", "latitude_deg and longitude_deg go together"),
        ] {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(shown.contains(said) && shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
    }
}
