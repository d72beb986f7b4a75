//! Where readings come from: a simulation or a recording. (The third source, the bus, is read where the bus is.)

use std::path::Path;

use launch::{Launch, Source};
use messages::SensorReading;
use recording::{Reader, RecordingError};
use scenario::{Motion, Scenario, ScenarioError, Sensors};

/// A reading as its source gives it; any value may be NaN.
pub use recording::{Reference as Truth, Row as Reading};

/// A reading from the bus, where nobody knows the truth.
pub fn reading_of(reading: SensorReading) -> Reading {
    let SensorReading { t_sensor_ns, rate_rad_s, force_m_s2 } = reading;
    Reading { t_ns: t_sensor_ns, rate_rad_s, force_m_s2, reference: None }
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
    Replay(Box<Reader>),
}

impl Readings {
    /// The readings of the source that `launch` names.
    pub fn open(launch: &Launch) -> Result<Self, SourceError> {
        match launch.ingest.source {
            Source::Sim => {
                let sim = &launch.ingest.sim;
                let mut scenario = Scenario::named(&sim.scenario)?.with_seed(sim.seed).with_rate_hz(sim.rate_hz);
                if let Motion::S1 | Motion::Tumble(_) = scenario.motion {
                    scenario.errors.gyro_bias_rad_s = sim.gyro_bias_deg_s.to_radians();
                    scenario.errors.accel_noise_m_s2 = sim.accel_noise_g * attitude::GRAVITY_M_S2;
                }
                Ok(Self::Sim { sensors: Box::new(scenario.sensors()), rate_hz: sim.rate_hz, count: 0 })
            }
            Source::Replay => Ok(Self::Replay(Box::new(Reader::open(Path::new(&launch.ingest.replay.file))?))),
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
                    reference: Some(Truth { quaternion: [q.w, q.i, q.j, q.k], scored: true }),
                }))
            }
            Self::Replay(reader) => Some(reader.next()?.map_err(SourceError::from)),
        }
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
    /// Readings from the bus need the bus.
    #[error("reading sensors from the bus: there is no bus inside one process; leave out --in-process")]
    NoBus,
}
