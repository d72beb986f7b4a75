//! Where readings come from: a simulation or a recording. (What comes over the bus is read where the bus is.)

use std::path::{Path, PathBuf};

use attitude::{calibration::CalibrationError, gnss::Fix};
use launch::{Gnss, Launch, Replay, Source};
use messages::{ReceiverReading, SensorReading};
use recording::{
    Reader, RecordingError, Row,
    gnss::{self, FixReader},
};
use scenario::{ScenarioError, Sensors};

pub use recording::Reference as Truth;

/// A reading as its source gives it; any value may be NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time on the source's clock, ns.
    pub t_ns: i64,
    /// Body rate, rad/s, sensor axes.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s², sensor axes.
    pub force_m_s2: [f64; 3],
    /// Magnetic field, µT, sensor axes, where there is a sample.
    pub field_ut: Option<[f64; 3]>,
    /// What a satellite receiver said since the reading before.
    pub fix: Option<ReceiverFix>,
    /// The true attitude, where the source knows it.
    pub reference: Option<Truth>,
}

/// A fix, and where it was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceiverFix {
    /// What stages know of it.
    pub fix: Fix,
    /// Longitude, rad, east positive, where it is known.
    pub longitude_rad: Option<f64>,
    /// Altitude as the receiver gives it, m, where it is known.
    pub altitude_m: Option<f64>,
}

impl From<Fix> for ReceiverFix {
    fn from(fix: Fix) -> Self {
        Self { fix, longitude_rad: None, altitude_m: None }
    }
}

impl Reading {
    /// The same with 0 for −0, which tells no more and which protobuf leaves out: a flight and its replay see the same numbers.
    pub fn without_negative_zero(&self) -> Self {
        let Self { t_ns, rate_rad_s, force_m_s2, field_ut, fix, reference } = *self;
        let all = |values: [f64; 3]| values.map(|value| value + 0.0);
        let one = |value: Option<f64>| value.map(|value| value + 0.0);
        Self {
            t_ns,
            rate_rad_s: all(rate_rad_s),
            force_m_s2: all(force_m_s2),
            field_ut: field_ut.map(all),
            fix: fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| ReceiverFix {
                fix: Fix {
                    velocity_m_s: all(fix.velocity_m_s.into()).into(),
                    sd_m_s: one(fix.sd_m_s),
                    age_s: one(fix.age_s),
                    latitude_rad: one(fix.latitude_rad),
                },
                longitude_rad: one(longitude_rad),
                altitude_m: one(altitude_m),
            }),
            reference,
        }
    }
}

impl From<Row> for Reading {
    fn from(row: Row) -> Self {
        let Row { t_ns, rate_rad_s, force_m_s2, field_ut, reference } = row;
        Self { t_ns, rate_rad_s, force_m_s2, field_ut, fix: None, reference }
    }
}

impl From<SensorReading> for Reading {
    fn from(reading: SensorReading) -> Self {
        let SensorReading { t_sensor_ns, rate_rad_s, force_m_s2, field_ut } = reading;
        let field_ut = (!field_ut.iter().all(|x| x.is_nan())).then_some(field_ut);
        Self { t_ns: t_sensor_ns, rate_rad_s, force_m_s2, field_ut, fix: None, reference: None }
    }
}

/// What a receiver says over the bus.
pub fn fix_of(reading: ReceiverReading) -> ReceiverFix {
    let told = |value: f64| value.is_finite().then_some(value);
    ReceiverFix {
        fix: Fix {
            velocity_m_s: reading.velocity_m_s.into(),
            sd_m_s: told(reading.velocity_sd_m_s),
            age_s: told(reading.age_s),
            latitude_rad: told(reading.latitude_rad),
        },
        longitude_rad: told(reading.longitude_rad),
        altitude_m: told(reading.altitude_m),
    }
}

/// Readings that are there before they are asked for.
pub enum Readings {
    /// A simulated body.
    Sim {
        /// Its sensors.
        sensors: Box<Sensors>,
        /// Readings per second.
        rate_hz: f64,
        /// Readings taken.
        count: u64,
    },
    /// A recording.
    Replay(Box<Recorded>),
}

impl Readings {
    /// The readings of the source that `launch` names.
    pub fn open(launch: &Launch) -> Result<Self, SourceError> {
        match launch.ingest.source {
            Source::Sim => {
                let sim = &launch.ingest.sim;
                let scenario = sim.scenario()?;
                Ok(Self::Sim { sensors: Box::new(scenario.sensors()), rate_hz: sim.rate_hz, count: 0 })
            }
            Source::Replay => {
                let Replay { file, gnss, mag, .. } = &launch.ingest.replay;
                Ok(Self::Replay(Box::new(Recorded::open(file, fixes_of(file, gnss).as_deref(), *mag)?)))
            }
            Source::Bus
            | Source::Stdin
            | Source::Udp
            | Source::Tcp
            | Source::Serial
            | Source::Mavlink
            | Source::Iio => Err(SourceError::NoBus),
        }
    }
}

impl Iterator for Readings {
    type Item = Result<Reading, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::Sim { sensors, rate_hz, count } => {
                let t_s = *count as f64 / *rate_hz;
                *count += 1;
                let reading = sensors.read(t_s);
                let q = reading.truth.attitude.quaternion();
                Some(Ok(Reading {
                    t_ns: (t_s * 1e9).round() as i64,
                    rate_rad_s: reading.rate_rad_s.into(),
                    force_m_s2: reading.force_m_s2.into(),
                    field_ut: reading.field_ut.map(Into::into),
                    fix: reading.fix.map(Into::into),
                    reference: Some(Truth { quaternion: [q.w, q.i, q.j, q.k], scored: true }),
                }))
            }
            Self::Replay(recorded) => Some(recorded.next()?.map_err(SourceError::from)),
        }
    }
}

/// A recording with the fixes beside it.
pub struct Recorded {
    rows: Reader,
    fixes: Option<FixReader>,
    mag: bool,
}

impl Recorded {
    /// Opens both. Without `mag` the magnetic field is left out.
    pub fn open(file: &Path, fixes: Option<&Path>, mag: bool) -> Result<Self, RecordingError> {
        Ok(Self { rows: Reader::open(file)?, fixes: fixes.map(FixReader::open).transpose()?, mag })
    }

    fn read(&mut self, row: Row) -> Result<Reading, RecordingError> {
        let fix = self.fixes.as_mut().map_or(Ok(None), |fixes| fixes.latest_until(row.t_ns))?;
        let fix = fix.map(|fix| ReceiverFix {
            fix: Fix {
                velocity_m_s: fix.velocity_m_s.into(),
                sd_m_s: None,
                age_s: None,
                latitude_rad: fix.latitude_deg.map(f64::to_radians),
            },
            longitude_rad: fix.longitude_deg.map(f64::to_radians),
            altitude_m: fix.altitude_m,
        });
        let reading = Reading::from(row);
        Ok(Reading { fix, field_ut: reading.field_ut.filter(|_| self.mag), ..reading })
    }
}

impl Iterator for Recorded {
    type Item = Result<Reading, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        Some(self.rows.next()?.and_then(|row| self.read(row)))
    }
}

/// The file with the fixes that go with a recording, where there is one.
pub fn fixes_of(recording: &Path, gnss: &Gnss) -> Option<PathBuf> {
    match gnss {
        Gnss::Auto => gnss::find_for(recording),
        Gnss::Off => None,
        Gnss::File(path) => Some(path.clone()),
    }
}

/// Why a source gave no reading.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// There is no such scenario.
    #[error("simulating: {0}")]
    Scenario(#[from] ScenarioError),
    /// A calibration or a mounting that is none.
    #[error("placing the sensors in the body: {0}")]
    Body(#[from] CalibrationError),
    /// Readings from the bus need the bus.
    #[error("reading sensors from the bus: there is no bus inside one process; leave out --in-process")]
    NoBus,
}
