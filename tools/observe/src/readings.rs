//! The sensors' own readings of a running system, for a calibration.

use attitude::calibration::CalibrationError;
use bytemuck::try_pod_read_unaligned;
use calibrate::{Known, Sample};
use graph::Topic;
use ingest::source::Reading;
use launch::{Calibrations, Launch, Source};
use messages::{SensorReading, TakenReading};
use runtime::ServiceConfig;

/// Why a running system cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum ReadingsError {
    /// They stay within ingest.
    #[error(
        "calibrating from {system:?}: its source is a simulation or a recording, whose readings are not published; start it by \
         `plumb up --readings`"
    )]
    NotPublished {
        /// The system.
        system: String,
    },
    /// A calibration of the launch file acts on nothing.
    #[error("calibrating from a running system: [ingest.calibration]: {0}")]
    Calibration(#[from] CalibrationError),
}

/// The topic that has them.
pub fn topic(config: &ServiceConfig) -> Result<Topic, ReadingsError> {
    match config.launch.ingest.source {
        _ if config.publishes_readings => Ok(Topic::Reading),
        Source::Sim | Source::Replay => Err(ReadingsError::NotPublished { system: config.launch.name.clone() }),
        _ => Ok(Topic::Sensor),
    }
}

/// What the system knows of its sensors, in the place of what was known.
pub fn build_on_system(known: &mut Known, config: &ServiceConfig) -> Result<(), CalibrationError> {
    known.rate_kind = config.gyro_samples().rate_kind();
    build_on(known, &config.launch)
}

/// The calibrations of a launch file, in the place of those that were known.
pub fn build_on(known: &mut Known, launch: &Launch) -> Result<(), CalibrationError> {
    let Calibrations { gyro, accel, mag } = &launch.ingest.calibration;
    (known.gyro, known.accel, known.mag) = (gyro.to_calibration()?, accel.to_calibration()?, mag.to_calibration()?);
    Ok(())
}

/// The reading in a message of [`topic`]; `None` of bytes that are none.
pub fn sample(topic: Topic, bytes: &[u8]) -> Option<Sample> {
    let reading = match topic {
        Topic::Reading => Reading::from(&try_pod_read_unaligned::<TakenReading>(bytes).ok()?),
        _ => Reading::from(try_pod_read_unaligned::<SensorReading>(bytes).ok()?),
    };
    Some(sample_of(&reading))
}

/// A reading as a calibration takes it.
pub fn sample_of(reading: &Reading) -> Sample {
    let Reading { t_ns, rate_rad_s, force_m_s2, field_ut, .. } = *reading;
    Sample { t_ns, rate_rad_s: rate_rad_s.into(), force_m_s2: force_m_s2.into(), field_ut: field_ut.map(Into::into) }
}
