//! Sources of readings: simulation and recording. Readings over the bus are received by the service
//! `ingest`.

use std::path::{Path, PathBuf};

use attitude::{
    calibration::CalibrationError,
    conditioner,
    gnss::{Fix, ReceiverFix},
};
use launch::{Gnss, Launch, Replay, Source};
use messages::{ReceiverReading, SensorReading};
use recording::{
    Reader, RecordingError, Row,
    gnss::{self, FixReader},
};
use scenario::{ScenarioError, Sensors};

pub use recording::Reference as Truth;

/// Reading as reported by its source. Any value may be NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time on the source's clock, ns.
    pub t_ns: i64,
    /// Body rate, rad/s, sensor axes.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s², sensor axes.
    pub force_m_s2: [f64; 3],
    /// Magnetic field, µT, sensor axes; `None` if the reading has none.
    pub field_ut: Option<[f64; 3]>,
    /// Fix received since the previous reading.
    pub fix: Option<ReceiverFix>,
    /// True attitude, if the source provides it.
    pub reference: Option<Truth>,
}

impl Reading {
    /// Returns the values of the sensors, without the true attitude.
    pub fn sensors(&self) -> conditioner::Reading {
        let Self { t_ns, rate_rad_s, force_m_s2, field_ut, fix, reference: _ } = *self;
        conditioner::Reading { t_ns, rate_rad_s, force_m_s2, field_ut, fix }
    }

    /// Returns the reading with each −0 in the sensor values replaced by 0.
    pub fn without_negative_zero(&self) -> Self {
        let conditioner::Reading { t_ns, rate_rad_s, force_m_s2, field_ut, fix } =
            self.sensors().without_negative_zero();
        Self { t_ns, rate_rad_s, force_m_s2, field_ut, fix, reference: self.reference }
    }

    /// Converts a reading of a simulation at the time `t_s`. `scored` is set if its reference is
    /// compared with estimates.
    pub fn simulated(t_s: f64, reading: scenario::Reading, scored: bool) -> Self {
        let q = reading.truth.attitude.quaternion();
        Self {
            t_ns: (t_s * 1e9).round() as i64,
            rate_rad_s: reading.rate_rad_s.into(),
            force_m_s2: reading.force_m_s2.into(),
            field_ut: reading.field_ut.map(Into::into),
            fix: reading.fix.map(Into::into),
            reference: Some(Truth { quaternion: [q.w, q.i, q.j, q.k], scored }),
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

/// Converts a receiver message from the bus to a fix. Optional values that are not finite become
/// `None`.
pub fn receiver_fix(reading: ReceiverReading) -> ReceiverFix {
    let finite = |value: f64| value.is_finite().then_some(value);
    ReceiverFix {
        fix: Fix {
            velocity_m_s: reading.velocity_m_s.into(),
            sd_m_s: finite(reading.velocity_sd_m_s),
            age_s: finite(reading.age_s),
            latitude_rad: finite(reading.latitude_rad),
        },
        longitude_rad: finite(reading.longitude_rad),
        altitude_m: finite(reading.altitude_m),
    }
}

/// Readings that are available without waiting.
pub enum Readings {
    /// Simulated sensors.
    Sim {
        /// Sensors of the scenario.
        sensors: Box<Sensors>,
        /// Sampling rate, Hz.
        rate_hz: f64,
        /// Number of readings so far.
        count: u64,
    },
    /// Recording.
    Replay(Box<RecordedReadings>),
}

impl Readings {
    /// Opens the source that `launch` names.
    ///
    /// # Errors
    ///
    /// Returns an error if the scenario is invalid, the recording cannot be opened, or the source
    /// needs the bus.
    pub fn open(launch: &Launch) -> Result<Self, SourceError> {
        match launch.ingest.source {
            Source::Sim => {
                let sim = &launch.ingest.sim;
                let scenario = sim.scenario()?;
                Ok(Self::Sim { sensors: Box::new(scenario.sensors()), rate_hz: sim.rate_hz, count: 0 })
            }
            Source::Replay => {
                let Replay { file, gnss, mag, .. } = &launch.ingest.replay;
                Ok(Self::Replay(Box::new(RecordedReadings::open(file, fixes_path(file, gnss).as_deref(), *mag)?)))
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
                Some(Ok(Reading::simulated(t_s, sensors.read(t_s), true)))
            }
            Self::Replay(recorded) => Some(recorded.next()?.map_err(SourceError::from)),
        }
    }
}

/// Readings of a recording and the fixes that belong to it.
pub struct RecordedReadings {
    rows: Reader,
    fixes: Option<FixReader>,
    has_mag: bool,
}

impl RecordedReadings {
    /// Opens a recording and its fixes. If `mag` is `false`, the magnetic field is ignored.
    ///
    /// # Errors
    ///
    /// Returns an error if a file cannot be opened or its header is malformed.
    pub fn open(file: &Path, fixes: Option<&Path>, mag: bool) -> Result<Self, RecordingError> {
        Ok(Self { rows: Reader::open(file)?, fixes: fixes.map(FixReader::open).transpose()?, has_mag: mag })
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
        Ok(Reading { fix, field_ut: reading.field_ut.filter(|_| self.has_mag), ..reading })
    }
}

impl Iterator for RecordedReadings {
    type Item = Result<Reading, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        Some(self.rows.next()?.and_then(|row| self.read(row)))
    }
}

/// Returns the path of the fixes that belong to a recording, or `None` if it has no fixes.
pub fn fixes_path(recording: &Path, gnss: &Gnss) -> Option<PathBuf> {
    match gnss {
        Gnss::Auto => gnss::find_for(recording),
        Gnss::Off => None,
        Gnss::File(path) => Some(path.clone()),
    }
}

/// Error of a source.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The scenario is invalid.
    #[error("simulating: {0}")]
    Scenario(#[from] ScenarioError),
    /// A calibration or the mounting is invalid.
    #[error("invalid calibration or mounting: {0}")]
    Mounting(#[from] CalibrationError),
    /// The source needs the bus, which is not available in one process.
    #[error(
        "reading sensors from a device or the bus: --in-process works with simulation, replay and standard input only; remove --in-process"
    )]
    NoBus,
}
