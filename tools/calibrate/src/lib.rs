//! Calibration: what a sensor's readings say about its own errors, as a piece of `launch.toml`.
//!
//! Input: raw readings of one sensor unit, in the order of their times. Output: the errors with their standard deviations, the residuals
//! before and after, the coverage, and the piece of the launch file; or what is missing for that. Time: the readings' own; no clock is
//! read. Failure: thin coverage is refused, with what is to be done about it; readings that are no numbers are left out.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`gyro`] | bias, from rests |
//! | [`accel`] | bias, scale and misalignment, from rests in several positions, or from slow turns through them |
//! | [`mag`] | hard and soft iron, from the field in all directions |
//! | [`mounting`] | how the unit sits in the body, from a level and a nose-down pose |
//! | [`clock`] | how late the magnetometer is on the gyro, from turns to and fro |
//! | [`report`] | what is printed |
//! | `rest` | when the unit rests, and how exactly the mean of a rest is known |
//! | `motion` | gravity felt in motion |
//! | `sphere` | in which directions there was a reading |
//! | `ellipsoid` | the model that accelerometer and magnetometer have in common |
//! | `least_squares` | normal equations and covariances |
//! | `history` | the attitude by the gyro at any moment |
#![forbid(unsafe_code)]

pub mod accel;
pub mod clock;
mod ellipsoid;
pub mod gyro;
mod history;
mod least_squares;
pub mod mag;
mod motion;
pub mod mounting;
pub mod report;
mod rest;
mod sphere;

use std::fmt;

use attitude::{GRAVITY_M_S2, Vector3, calibration::Calibration, gyro::RateKind};

pub use report::{Coverage, Refusal, Report};
pub use sphere::PARTS;

/// Times farther from zero than 126 years are left out, ns: differences of the others fit into 64 bits.
const MAX_T_NS: u64 = 4_000_000_000_000_000_000;

/// A raw reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time on the sensor's clock, ns.
    pub t_ns: i64,
    /// Rate, rad/s, sensor axes.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force, m/s², sensor axes.
    pub force_m_s2: Vector3<f64>,
    /// Magnetic field, µT, sensor axes, where there is a sample.
    pub field_ut: Option<Vector3<f64>>,
}

/// What is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The gyro's bias.
    Gyro,
    /// The accelerometer's bias, scale and misalignment.
    Accel,
    /// The magnetometer's hard and soft iron.
    Mag,
    /// How the unit sits in the body.
    Mounting,
    /// The magnetometer's delay.
    Clock,
}

impl Kind {
    /// Every one with the name that people ask for it by.
    pub const NAMES: [(&str, Self); 5] = [
        ("gyro", Self::Gyro),
        ("accel", Self::Accel),
        ("mag", Self::Mag),
        ("mounting", Self::Mounting),
        ("clock", Self::Clock),
    ];
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gyro => "gyro",
            Self::Accel => "accelerometer",
            Self::Mag => "magnetometer",
            Self::Mounting => "mounting",
            Self::Clock => "clock",
        })
    }
}

/// What is known before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Gravity of the place, m/s².
    pub gravity_m_s2: f64,
    /// Strength of the earth's field at the place, µT.
    pub field_ut: Option<f64>,
    /// What a rate sample says about its interval.
    pub rate_kind: RateKind,
    /// The calibrations that stand already; [`Kind::Mounting`], [`Kind::Clock`] and, for the gyro, [`Kind::Accel`] build on them, the others
    /// begin at the raw readings.
    pub gyro: Calibration,
    /// Likewise.
    pub accel: Calibration,
    /// Likewise.
    pub mag: Calibration,
}

impl Default for Known {
    fn default() -> Self {
        Self {
            gravity_m_s2: GRAVITY_M_S2,
            field_ut: None,
            rate_kind: RateKind::Mean,
            gyro: Calibration::default(),
            accel: Calibration::default(),
            mag: Calibration::default(),
        }
    }
}

/// Takes readings until there are enough.
#[derive(Debug, Clone)]
pub struct Calibrator {
    of: Of,
    last_ns: Option<i64>,
    taken: u64,
    left_out: u64,
}

#[derive(Debug, Clone)]
enum Of {
    Gyro(gyro::Gyro),
    Accel(Box<accel::Accel>),
    Mag(mag::Mag),
    Mounting(mounting::Mounting),
    Clock(clock::Clock),
}

impl Calibrator {
    /// One that has seen nothing.
    pub fn new(kind: Kind, known: &Known) -> Self {
        let of = match kind {
            Kind::Gyro => Of::Gyro(gyro::Gyro::default()),
            Kind::Accel => Of::Accel(Box::new(accel::Accel::new(known))),
            Kind::Mag => Of::Mag(mag::Mag::new(known)),
            Kind::Mounting => Of::Mounting(mounting::Mounting::new(known)),
            Kind::Clock => Of::Clock(clock::Clock::new(known)),
        };
        Self { of, last_ns: None, taken: 0, left_out: 0 }
    }

    /// Takes the next reading. One whose rate or force is not finite, or whose time does not go on, is left out.
    pub fn take(&mut self, sample: &Sample) {
        let is_sound = sample.rate_rad_s.iter().chain(&sample.force_m_s2).all(|part| part.is_finite())
            && sample.t_ns.unsigned_abs() <= MAX_T_NS
            && self.last_ns.is_none_or(|last_ns| sample.t_ns > last_ns);
        if !is_sound {
            self.left_out += 1;
            return;
        }
        self.last_ns = Some(sample.t_ns);
        self.taken += 1;
        let field_ut = sample.field_ut.filter(|field_ut| field_ut.iter().all(|part| part.is_finite()));
        let sample = Sample { field_ut, ..*sample };
        match &mut self.of {
            Of::Gyro(of) => of.take(&sample),
            Of::Accel(of) => of.take(&sample),
            Of::Mag(of) => of.take(&sample),
            Of::Mounting(of) => of.take(&sample),
            Of::Clock(of) => of.take(&sample),
        }
    }

    /// How far what was taken suffices.
    pub fn coverage(&self) -> Coverage {
        match &self.of {
            Of::Gyro(of) => of.coverage(),
            Of::Accel(of) => of.coverage(),
            Of::Mag(of) => of.coverage(),
            Of::Mounting(of) => of.coverage(),
            Of::Clock(of) => of.coverage(),
        }
    }

    /// Whether each of the [`PARTS`] of the sphere is covered, sensor axes; `None` where directions do not count.
    pub fn parts(&self) -> Option<[bool; PARTS]> {
        match &self.of {
            Of::Accel(of) => Some(of.parts()),
            Of::Mag(of) => Some(of.parts()),
            Of::Gyro(_) | Of::Mounting(_) | Of::Clock(_) => None,
        }
    }

    /// Where the force or the field of the last reading points whose directions count, sensor axes.
    pub fn direction(&self) -> Option<Vector3<f64>> {
        match &self.of {
            Of::Accel(of) => of.direction(),
            Of::Mag(of) => of.direction(),
            Of::Gyro(_) | Of::Mounting(_) | Of::Clock(_) => None,
        }
    }

    /// What was found, or what is missing.
    pub fn finish(&self) -> Result<Report, Refusal> {
        let mut report = match &self.of {
            Of::Gyro(of) => of.finish(),
            Of::Accel(of) => of.finish(),
            Of::Mag(of) => of.finish(),
            Of::Mounting(of) => of.finish(),
            Of::Clock(of) => of.finish(),
        }?;
        if self.left_out > 0 {
            report.notes.push(format!(
                "{} of {} readings were left out: no numbers, or a time that does not go on",
                self.left_out,
                self.taken + self.left_out
            ));
        }
        Ok(report)
    }
}
