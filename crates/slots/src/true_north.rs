//! Conversion of magnetic courses to true courses with the World Magnetic Model.
//!
//! - Input: the position in the launch file, and positions from satellite fixes.
//! - Output: readings with a true course.
//! - Time: one date per run, so that the same fixes always give the same courses.
//! - Failure: if no position is known, the course stays magnetic and is reported as such.

use std::f64::consts::{PI, TAU};

use attitude::{
    course::{CourseReading, CourseReference},
    state_words::StateWords,
};
use launch::{Date, MODEL_YEARS, NorthReference, Position};
use messages::GnssFix;
use world_magnetic_model::{
    GeomagneticField, time,
    uom::si::{
        angle::{degree, radian},
        f32::{Angle, Length},
        length::meter,
    },
};

/// Altitude range of the model, m.
const ALTITUDES_M: [f64; 2] = [-1000.0, 850_000.0];

/// Conversion of magnetic courses to true courses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TrueNorth {
    /// Date of the run; `None` if true north is not requested.
    date: Option<time::Date>,
    declination: Option<Declination>,
    /// Set if the previous course referred to magnetic north.
    was_magnetic: bool,
}

/// Magnetic declination and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Declination {
    /// Direction of magnetic north relative to true north, rad, east positive.
    pub(crate) angle_rad: f64,
    /// Standard deviation as given by the model, rad.
    pub(crate) sd_rad: f64,
}

impl TrueNorth {
    /// Creates the conversion that the launch file requests.
    ///
    /// # Errors
    ///
    /// Returns an error if true north is requested without a date that the model covers.
    pub(crate) fn new(north: &NorthReference) -> Result<Self, String> {
        let mut conversion = Self { date: None, declination: None, was_magnetic: false };
        if north.is_true {
            let date = north.date.and_then(calendar_day);
            conversion.date = Some(date.ok_or_else(|| {
                let (first, last) = (MODEL_YEARS.start(), MODEL_YEARS.end());
                format!("true north needs a date from {first} to {last}, the years of the magnetic model; set date in [course]")
            })?);
            if let Some(position) = north.position {
                conversion.set_position(position);
            }
        }
        Ok(conversion)
    }

    /// Updates the declination from a fix. A fix without a position changes nothing.
    pub(crate) fn update_position(&mut self, fix: &GnssFix) {
        let position = Position {
            latitude_deg: fix.latitude_rad.to_degrees(),
            longitude_deg: fix.longitude_rad.to_degrees(),
            altitude_m: if fix.altitude_m.is_finite() { fix.altitude_m } else { 0.0 },
        };
        self.set_position(position);
    }

    /// Converts a magnetic course to a true one if the declination is known.
    ///
    /// The first true course after a magnetic one is flagged as a jump.
    pub(crate) fn apply(&mut self, reading: CourseReading) -> CourseReading {
        let is_magnetic = reading.reference == CourseReference::Magnetic;
        let Some(declination) = self.declination.filter(|_| is_magnetic) else {
            self.was_magnetic = is_magnetic;
            return reading;
        };
        let is_jump = std::mem::replace(&mut self.was_magnetic, false);
        CourseReading {
            course_rad: (reading.course_rad + declination.angle_rad).rem_euclid(TAU) % TAU,
            reference: CourseReference::True,
            course_sd_rad: reading.course_sd_rad.hypot(declination.sd_rad).min(PI),
            declination_rad: declination.angle_rad,
            aligned: reading.aligned || is_jump,
            ..reading
        }
    }

    /// Returns the reason why a restored state is invalid, or `None` if it is valid.
    pub(crate) fn validation_error(&self) -> Option<&'static str> {
        let Declination { angle_rad, sd_rad } = self.declination?;
        let is_valid = angle_rad.abs() <= PI + 1e-6 && sd_rad >= 0.0;
        (!is_valid).then_some("an invalid declination")
    }

    fn set_position(&mut self, position: Position) {
        if let Some(date) = self.date {
            self.declination = declination(position, date).or(self.declination);
        }
    }
}

/// Returns the declination at a position and date, or `None` outside the model's range.
pub(crate) fn declination(position: Position, date: time::Date) -> Option<Declination> {
    let Position { latitude_deg, longitude_deg, altitude_m } = position;
    let [lowest_m, highest_m] = ALTITUDES_M;
    let height = Length::new::<meter>(altitude_m.clamp(lowest_m, highest_m) as f32);
    let angle = |angle_deg: f64| Angle::new::<degree>(angle_deg as f32);
    let field = GeomagneticField::new(height, angle(latitude_deg), angle(longitude_deg), date).ok()?;
    let radians = |angle: Angle| f64::from(angle.get::<radian>());
    let declination =
        Declination { angle_rad: radians(field.declination()), sd_rad: radians(field.declination_uncertainty()) };
    (declination.angle_rad.is_finite() && declination.sd_rad.is_finite()).then_some(declination)
}

fn calendar_day(date: Date) -> Option<time::Date> {
    let month = time::Month::try_from(date.month).ok()?;
    time::Date::from_calendar_date(date.year.into(), month, date.day).ok()
}

impl StateWords for TrueNorth {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        // The date comes from the launch file, so it is not part of the state.
        let Self { date: _, declination, was_magnetic } = self;
        declination.visit(visit);
        was_magnetic.visit(visit);
    }
}

impl StateWords for Declination {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { angle_rad, sd_rad } = self;
        angle_rad.visit(visit);
        sd_rad.visit(visit);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn reading(course_deg: f64, reference: CourseReference) -> CourseReading {
        CourseReading {
            course_rad: course_deg.to_radians(),
            reference,
            course_sd_rad: 0.01,
            ..CourseReading::default()
        }
    }

    /// Creates a conversion at 80° N, 0° E on 1 January 2025, with a declination of 1.28° east.
    fn true_north(is_true: bool) -> TrueNorth {
        let position = Some(Position { latitude_deg: 80.0, longitude_deg: 0.0, altitude_m: 0.0 });
        TrueNorth::new(&NorthReference { is_true, position, date: Date::new(2025, 1, 1) }).unwrap()
    }

    /// Test values of NOAA NCEI and BGS, "WMM2020 Test Values" and "WMM2025 Test Values".
    ///
    /// The values come from the tables of the two reports (2025: table 6, doi 10.25923/prbc-s316)
    /// and from six entries of the list published with the coefficients of 2025. Columns: year,
    /// height in km, latitude, longitude and declination in degrees.
    const PUBLISHED: [(f64, f64, f64, f64, f64); 30] = [
        (2020.0, 0.0, 80.0, 0.0, -1.28),
        (2020.0, 0.0, 0.0, 120.0, 0.16),
        (2020.0, 0.0, -80.0, -120.0, 69.36),
        (2020.0, 100.0, 80.0, 0.0, -1.70),
        (2020.0, 100.0, 0.0, 120.0, 0.16),
        (2020.0, 100.0, -80.0, -120.0, 68.78),
        (2022.5, 0.0, 80.0, 0.0, 0.01),
        (2022.5, 0.0, 0.0, 120.0, -0.06),
        (2022.5, 0.0, -80.0, -120.0, 69.13),
        (2022.5, 100.0, 80.0, 0.0, -0.41),
        (2022.5, 100.0, 0.0, 120.0, -0.05),
        (2022.5, 100.0, -80.0, -120.0, 68.55),
        (2025.0, 0.0, 80.0, 0.0, 1.28),
        (2025.0, 0.0, 0.0, 120.0, -0.16),
        (2025.0, 0.0, -80.0, -120.0, 68.78),
        (2025.0, 100.0, 80.0, 0.0, 0.85),
        (2025.0, 100.0, 0.0, 120.0, -0.15),
        (2025.0, 100.0, -80.0, -120.0, 68.21),
        (2027.5, 0.0, 80.0, 0.0, 2.59),
        (2027.5, 0.0, 0.0, 120.0, -0.24),
        (2027.5, 0.0, -80.0, -120.0, 68.49),
        (2027.5, 100.0, 80.0, 0.0, 2.16),
        (2027.5, 100.0, 0.0, 120.0, -0.23),
        (2027.5, 100.0, -80.0, -120.0, 67.93),
        (2025.0, 28.0, 89.0, -121.0, -99.77),
        (2025.0, 65.0, 43.0, 93.0, 0.50),
        (2025.0, 51.0, -33.0, 109.0, -5.49),
        (2025.0, 18.0, 0.0, 21.0, 1.29),
        (2025.5, 50.0, -70.0, -133.0, 57.21),
        (2027.0, 67.0, -47.0, -32.0, -13.52),
    ];

    #[test]
    fn declination_matches_published_values_within_0_01_deg() {
        for (year, height_km, latitude_deg, longitude_deg, published_deg) in PUBLISHED {
            let day = 1 + ((year - year.floor()) * 365.0).round() as u16;
            let date = time::Date::from_ordinal_date(year as i32, day).unwrap();
            let position = Position { latitude_deg, longitude_deg, altitude_m: height_km * 1000.0 };
            let angle_deg = declination(position, date).unwrap().angle_rad.to_degrees();
            assert!((angle_deg - published_deg).abs() < 0.01, "{position:?} {date}: {angle_deg} and {published_deg}");
        }
    }

    #[test]
    fn only_magnetic_courses_are_converted() {
        let mut north = true_north(true);
        let converted = north.apply(reading(359.5, CourseReference::Magnetic));
        assert_eq!(
            (converted.reference, converted.aligned),
            (CourseReference::True, false),
            "no earlier course was magnetic"
        );
        assert!((converted.course_rad.to_degrees() - 0.78).abs() < 0.01, "{}", converted.course_rad.to_degrees());
        assert!((converted.declination_rad.to_degrees() - 1.28).abs() < 0.01 && converted.course_sd_rad > 0.01);
        for reference in [CourseReference::Arbitrary, CourseReference::True] {
            assert_eq!(north.apply(reading(10.0, reference)), reading(10.0, reference));
        }
        let magnetic = reading(10.0, CourseReference::Magnetic);
        assert_eq!(true_north(false).apply(magnetic), magnetic, "true north was not requested");
    }

    #[test]
    fn first_true_course_after_first_fix_is_a_jump() {
        let mut north =
            TrueNorth::new(&NorthReference { is_true: true, position: None, date: Date::new(2027, 7, 2) }).unwrap();
        let magnetic = reading(100.0, CourseReference::Magnetic);
        let nowhere = GnssFix { latitude_rad: f64::NAN, longitude_rad: f64::NAN, ..bytemuck::Zeroable::zeroed() };
        north.update_position(&nowhere);
        assert_eq!(north.apply(magnetic), magnetic);
        let fix = GnssFix { latitude_rad: (-80f64).to_radians(), longitude_rad: (-120f64).to_radians(), ..nowhere };
        north.update_position(&GnssFix { altitude_m: f64::NAN, ..fix });
        let (first, second) = (north.apply(magnetic), north.apply(magnetic));
        assert!((first.course_rad.to_degrees() - 168.49).abs() < 0.01, "{}", first.course_rad.to_degrees());
        assert_eq!((first.aligned, second.aligned), (true, false));
        north.update_position(&nowhere);
        assert_eq!(north.apply(magnetic), second, "the last position is kept");
    }

    #[test]
    fn restored_state_has_same_declination() {
        let (mut north, mut words) = (true_north(true), Vec::new());
        north.visit(&mut |word| words.push(*word));
        let mut other =
            TrueNorth::new(&NorthReference { is_true: true, position: None, date: Date::new(2025, 1, 1) }).unwrap();
        let mut next = words.iter();
        other.visit(&mut |word| *word = *next.next().unwrap());
        assert_eq!((other, other.validation_error()), (north, None));
        other.declination = Some(Declination { angle_rad: f64::NAN, sd_rad: 0.0 });
        assert!(other.validation_error().is_some());
    }

    #[test]
    fn true_north_without_date_is_rejected() {
        let error = TrueNorth::new(&NorthReference { is_true: true, position: None, date: None }).unwrap_err();
        assert!(error.contains("set date in [course]"), "{error}");
        for (year, month, day) in [(*MODEL_YEARS.start(), 1, 1), (*MODEL_YEARS.end(), 12, 31)] {
            let date = calendar_day(Date::new(year, month, day).unwrap()).unwrap();
            assert!(declination(Position::default(), date).is_some(), "{date}");
        }
    }
}
