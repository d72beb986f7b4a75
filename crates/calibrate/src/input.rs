//! Input of a calibration: its kind, prior knowledge and the readings.

use std::fmt;

use attitude::{GRAVITY_M_S2, Vector3, calibration::Calibration, gyro::RateKind};

/// Largest accepted magnitude of a timestamp, ns (126 years). It ensures that differences of
/// accepted timestamps fit into 64 bits.
const MAX_T_NS: u64 = 4_000_000_000_000_000_000;

/// Filter that skips and counts invalid readings.
#[derive(Debug, Clone, Default)]
pub(crate) struct Intake {
    last_ns: Option<i64>,
    accepted: u64,
    skipped: u64,
}

impl Intake {
    /// Returns the sample, without its magnetic field if the field is not finite.
    ///
    /// Returns `None` if the rate or force is not finite or the time does not increase.
    pub(crate) fn accept(&mut self, sample: &Sample) -> Option<Sample> {
        let is_valid = sample.rate_rad_s.iter().chain(&sample.force_m_s2).all(|part| part.is_finite())
            && sample.t_ns.unsigned_abs() <= MAX_T_NS
            && self.last_ns.is_none_or(|last_ns| sample.t_ns > last_ns);
        if !is_valid {
            self.skipped += 1;
            return None;
        }
        self.last_ns = Some(sample.t_ns);
        self.accepted += 1;
        let field_ut = sample.field_ut.filter(|field_ut| field_ut.iter().all(|part| part.is_finite()));
        Some(Sample { field_ut, ..*sample })
    }

    /// Returns a note with the number of skipped readings, if any.
    pub(crate) fn note(&self) -> Option<String> {
        let Self { accepted, skipped, .. } = self;
        (*skipped > 0).then(|| {
            format!("{skipped} of {} readings skipped: value not finite or time not increasing", accepted + skipped)
        })
    }
}

/// Raw reading of a sensor unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time on the sensor's clock, ns.
    pub t_ns: i64,
    /// Rate, rad/s, sensor axes.
    pub rate_rad_s: Vector3<f64>,
    /// Specific force, m/s², sensor axes.
    pub force_m_s2: Vector3<f64>,
    /// Magnetic field, µT, sensor axes; `None` if the reading has no magnetometer sample.
    pub field_ut: Option<Vector3<f64>>,
}

/// Kind of calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Gyro bias.
    Gyro,
    /// Accelerometer bias, scale and misalignment.
    Accel,
    /// Magnetometer hard and soft iron.
    Mag,
    /// Orientation of the unit in the body.
    Mounting,
    /// Magnetometer delay.
    Clock,
}

impl Kind {
    /// Command-line names of all calibrations.
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

/// Prior knowledge for a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Local gravity, m/s².
    pub gravity_m_s2: f64,
    /// Strength of the local magnetic field, µT; `None` if unknown.
    pub field_ut: Option<f64>,
    /// Meaning of a rate sample: mean over its interval, or value at the end of its interval.
    pub rate_kind: RateKind,
    /// Existing gyro calibration, used by [`Kind::Accel`] in motion and [`Kind::Clock`].
    pub gyro: Calibration,
    /// Existing accelerometer calibration, used by [`Kind::Mounting`].
    pub accel: Calibration,
    /// Existing magnetometer calibration, used by [`Kind::Clock`].
    pub mag: Calibration,
}

impl Default for Prior {
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
