//! Where readings come from: a simulation or a recording. (The third source, the bus, is read where the bus is.)

use std::path::Path;

use launch::{Launch, Source};
use messages::SensorReading;
use recording::{Reader, RecordingError};
use scenario::{Errors, Motion, Sensors};

/// A reading as its source gives it; any value may be NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The source's time stamp, ns.
    pub t_ns: i64,
    /// Body rate, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s².
    pub force_m_s2: [f64; 3],
    /// The true attitude, where the source knows it.
    pub truth: Option<Truth>,
}

/// The true attitude at a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Body → reference, w x y z, unit.
    pub quaternion: [f64; 4],
    /// An estimate is to be judged by it.
    pub scored: bool,
}

impl Reading {
    /// The sensor said the same again.
    pub fn is_same_as(&self, other: &Self) -> bool {
        let bits = |reading: &Self| (reading.rate_rad_s.map(f64::to_bits), reading.force_m_s2.map(f64::to_bits));
        bits(self) == bits(other)
    }
}

impl From<SensorReading> for Reading {
    fn from(reading: SensorReading) -> Self {
        let SensorReading { t_sensor_ns, rate_rad_s, force_m_s2 } = reading;
        Self { t_ns: t_sensor_ns, rate_rad_s, force_m_s2, truth: None }
    }
}

/// Readings that are there before they are asked for.
pub enum Readings {
    /// A simulated body.
    Sim {
        /// Its sensors.
        sensors: Sensors,
        /// Readings per second.
        rate_hz: f64,
        /// Readings taken.
        count: u64,
    },
    /// A recording.
    Replay(Reader),
}

impl Readings {
    /// The readings of the source that `launch` names.
    pub fn open(launch: &Launch) -> Result<Self, SourceError> {
        match launch.ingest.source {
            Source::Sim => {
                let sim = &launch.ingest.sim;
                let motion = Motion::named(&sim.scenario).ok_or(SourceError::Scenario(sim.scenario.clone()))?;
                let errors = Errors {
                    gyro_bias_rad_s: sim.gyro_bias_deg_s.to_radians(),
                    accel_noise_m_s2: sim.accel_noise_g * attitude::GRAVITY_M_S2,
                };
                Ok(Self::Sim { sensors: Sensors::new(motion, errors, sim.seed), rate_hz: sim.rate_hz, count: 0 })
            }
            Source::Replay => Ok(Self::Replay(Reader::open(Path::new(&launch.ingest.replay.file))?)),
            Source::Bus => Err(SourceError::NoBus),
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
                    truth: Some(Truth { quaternion: [q.w, q.i, q.j, q.k], scored: true }),
                }))
            }
            Self::Replay(reader) => reader.next().map(|row| {
                let row = row?;
                let truth = row.reference.map(|r| Truth { quaternion: r.quaternion, scored: r.scored });
                Ok(Reading { t_ns: row.t_ns, rate_rad_s: row.rate_rad_s, force_m_s2: row.force_m_s2, truth })
            }),
        }
    }
}

/// Why a source gave no reading.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// There is no such motion.
    #[error("simulating: there is no scenario `{0}`")]
    Scenario(String),
    /// Readings from the bus need the bus.
    #[error("reading sensors from the bus: there is no bus inside one process; leave out --in-process")]
    NoBus,
}
