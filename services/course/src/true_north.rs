//! True north from magnetic north, by the World Magnetic Model.
//!
//! Input: where the launch file says the vehicle is, and the fixes that know their place. Output: a reading whose magnetic course is made true. Time:
//! the one date of the run, so that the same fixes give the same courses. Failure: where no place is known the course stays magnetic, and says so.

use std::f64::consts::{PI, TAU};

use attitude::course::{Reading, Reference};
use launch::{Date, MODEL_YEARS, North, Position};
use messages::GnssFix;
use runtime::state_words::Words;
use world_magnetic_model::{
    GeomagneticField, time,
    uom::si::{
        angle::{degree, radian},
        f32::{Angle, Length},
        length::meter,
    },
};

/// Heights for which the model holds, m.
const ALTITUDES_M: [f64; 2] = [-1000.0, 850_000.0];

/// Makes magnetic courses true.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TrueNorth {
    /// None where a course stays as the stage gives it.
    date: Option<time::Date>,
    declination: Option<Declination>,
    /// The course before was magnetic.
    was_magnetic: bool,
}

/// Where magnetic north is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Declination {
    /// From true north, rad, east positive.
    pub(crate) angle_rad: f64,
    /// Its standard deviation by the model's own, rad.
    pub(crate) sd_rad: f64,
}

impl TrueNorth {
    /// What the launch file says; an error where it wants true north of no day.
    pub(crate) fn new(north: &North) -> Result<Self, String> {
        let mut it = Self { date: None, declination: None, was_magnetic: false };
        if north.is_true {
            let date = north.date.and_then(calendar_day);
            it.date = Some(date.ok_or_else(|| {
                let (first, last) = (MODEL_YEARS.start(), MODEL_YEARS.end());
                format!("true north: the magnetic model needs a date of {first} to {last}; set date in [course]")
            })?);
            if let Some(position) = north.position {
                it.stand_at(position);
            }
        }
        Ok(it)
    }

    /// A fix; one without a place changes nothing.
    pub(crate) fn note(&mut self, fix: &GnssFix) {
        let position = Position {
            latitude_deg: fix.latitude_rad.to_degrees(),
            longitude_deg: fix.longitude_rad.to_degrees(),
            altitude_m: if fix.altitude_m.is_finite() { fix.altitude_m } else { 0.0 },
        };
        self.stand_at(position);
    }

    /// The reading, its course from true north where the stage counts it from magnetic north and a place is known. The first after a magnetic one is
    /// a jump of the course.
    pub(crate) fn apply(&mut self, reading: Reading) -> Reading {
        let is_magnetic = reading.reference == Reference::Magnetic;
        let Some(declination) = self.declination.filter(|_| is_magnetic) else {
            self.was_magnetic = is_magnetic;
            return reading;
        };
        let jumps = std::mem::replace(&mut self.was_magnetic, false);
        Reading {
            course_rad: (reading.course_rad + declination.angle_rad).rem_euclid(TAU) % TAU,
            reference: Reference::True,
            course_sd_rad: reading.course_sd_rad.hypot(declination.sd_rad).min(PI),
            declination_rad: declination.angle_rad,
            aligned: reading.aligned || jumps,
            ..reading
        }
    }

    /// Why the state is none.
    pub(crate) fn flaw(&self) -> Option<&'static str> {
        let Declination { angle_rad, sd_rad } = self.declination?;
        let sound = angle_rad.abs() <= PI + 1e-6 && sd_rad >= 0.0;
        (!sound).then_some("a declination that no place has")
    }

    fn stand_at(&mut self, position: Position) {
        if let Some(date) = self.date {
            self.declination = declination(position, date).or(self.declination);
        }
    }
}

/// The declination of a place on a day; `None` of no place.
pub(crate) fn declination(position: Position, date: time::Date) -> Option<Declination> {
    let Position { latitude_deg, longitude_deg, altitude_m } = position;
    let [lowest_m, highest_m] = ALTITUDES_M;
    let height = Length::new::<meter>(altitude_m.clamp(lowest_m, highest_m) as f32);
    let angle = |angle_deg: f64| Angle::new::<degree>(angle_deg as f32);
    let field = GeomagneticField::new(height, angle(latitude_deg), angle(longitude_deg), date).ok()?;
    let of = |angle: Angle| f64::from(angle.get::<radian>());
    let declination = Declination { angle_rad: of(field.declination()), sd_rad: of(field.declination_uncertainty()) };
    (declination.angle_rad.is_finite() && declination.sd_rad.is_finite()).then_some(declination)
}

fn calendar_day(date: Date) -> Option<time::Date> {
    let month = time::Month::try_from(date.month).ok()?;
    time::Date::from_calendar_date(date.year.into(), month, date.day).ok()
}

impl Words for TrueNorth {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        // The date is the launch file's.
        let Self { date: _, declination, was_magnetic } = self;
        declination.visit(visit);
        was_magnetic.visit(visit);
    }
}

impl Words for Declination {
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

    fn reading(course_deg: f64, reference: Reference) -> Reading {
        Reading { course_rad: course_deg.to_radians(), reference, course_sd_rad: 0.01, ..Reading::default() }
    }

    /// At 80° N, 0° E on the 1st of January 2025: 1.28° east.
    fn known(is_true: bool) -> TrueNorth {
        let position = Some(Position { latitude_deg: 80.0, longitude_deg: 0.0, altitude_m: 0.0 });
        TrueNorth::new(&North { is_true, position, date: Date::new(2025, 1, 1) }).unwrap()
    }

    /// "WMM2020 Test Values" and "WMM2025 Test Values" of NOAA NCEI and BGS: the tables of the two reports (of 2025: table 6, doi
    /// 10.25923/prbc-s316) and six of the list that goes with the coefficients of 2025. Year, height in km, latitude, longitude, declination in
    /// degrees.
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
    fn the_published_values_are_met_to_their_last_digit() {
        for (year, height_km, latitude_deg, longitude_deg, published_deg) in PUBLISHED {
            let day = 1 + ((year - year.floor()) * 365.0).round() as u16;
            let date = time::Date::from_ordinal_date(year as i32, day).unwrap();
            let place = Position { latitude_deg, longitude_deg, altitude_m: height_km * 1000.0 };
            let angle_deg = declination(place, date).unwrap().angle_rad.to_degrees();
            assert!((angle_deg - published_deg).abs() < 0.01, "{place:?} {date}: {angle_deg} and {published_deg}");
        }
    }

    #[test]
    fn only_a_magnetic_course_is_made_true() {
        let mut north = known(true);
        let read = north.apply(reading(359.5, Reference::Magnetic));
        assert_eq!((read.reference, read.aligned), (Reference::True, false), "nothing was magnetic before");
        assert!((read.course_rad.to_degrees() - 0.78).abs() < 0.01, "{}", read.course_rad.to_degrees());
        assert!((read.declination_rad.to_degrees() - 1.28).abs() < 0.01 && read.course_sd_rad > 0.01);
        for reference in [Reference::Arbitrary, Reference::True] {
            assert_eq!(north.apply(reading(10.0, reference)), reading(10.0, reference));
        }
        let magnetic = reading(10.0, Reference::Magnetic);
        assert_eq!(known(false).apply(magnetic), magnetic, "nobody asked for it");
    }

    #[test]
    fn a_course_that_becomes_true_with_the_first_fix_is_a_jump() {
        let mut north = TrueNorth::new(&North { is_true: true, position: None, date: Date::new(2027, 7, 2) }).unwrap();
        let magnetic = reading(100.0, Reference::Magnetic);
        let nowhere = GnssFix { latitude_rad: f64::NAN, longitude_rad: f64::NAN, ..bytemuck::Zeroable::zeroed() };
        north.note(&nowhere);
        assert_eq!(north.apply(magnetic), magnetic);
        let fix = GnssFix { latitude_rad: (-80f64).to_radians(), longitude_rad: (-120f64).to_radians(), ..nowhere };
        north.note(&GnssFix { altitude_m: f64::NAN, ..fix });
        let (first, second) = (north.apply(magnetic), north.apply(magnetic));
        assert!((first.course_rad.to_degrees() - 168.49).abs() < 0.01, "{}", first.course_rad.to_degrees());
        assert_eq!((first.aligned, second.aligned), (true, false));
        north.note(&nowhere);
        assert_eq!(north.apply(magnetic), second, "the last place counts");
    }

    #[test]
    fn another_incarnation_goes_on_with_the_same_declination() {
        let (mut north, mut words) = (known(true), Vec::new());
        north.visit(&mut |word| words.push(*word));
        let mut other = TrueNorth::new(&North { is_true: true, position: None, date: Date::new(2025, 1, 1) }).unwrap();
        let mut next = words.iter();
        other.visit(&mut |word| *word = *next.next().unwrap());
        assert_eq!((other, other.flaw()), (north, None));
        other.declination = Some(Declination { angle_rad: f64::NAN, sd_rad: 0.0 });
        assert!(other.flaw().is_some());
    }

    #[test]
    fn true_north_of_no_day_is_refused() {
        let said = TrueNorth::new(&North { is_true: true, position: None, date: None }).unwrap_err();
        assert!(said.contains("set date in [course]"), "{said}");
        for (year, month, day) in [(*MODEL_YEARS.start(), 1, 1), (*MODEL_YEARS.end(), 12, 31)] {
            let date = calendar_day(Date::new(year, month, day).unwrap()).unwrap();
            assert!(declination(Position::default(), date).is_some(), "{date}");
        }
    }
}
