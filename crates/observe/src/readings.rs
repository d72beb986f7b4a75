//! Raw sensor readings of a running system, for a calibration.

use attitude::calibration::CalibrationError;
use bytemuck::try_pod_read_unaligned;
use calibrate::{Prior, Sample};
use graph::Topic;
use launch::{Calibrations, Launch, Source};
use messages::{SensorReading, TakenReading};
use readings::source::Reading;
use runtime::ServiceConfig;

/// Reason why a running system cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum ReadingsError {
    /// The system does not publish its raw readings.
    #[error(
        "calibrating from {system:?}: a simulation or recording does not publish its readings; start the system with \
         `plumb up --readings`"
    )]
    NotPublished {
        /// Name of the system.
        system: String,
    },
    /// A calibration in the launch file is invalid.
    #[error("calibrating from a running system: [ingest.calibration]: {0}")]
    Calibration(#[from] CalibrationError),
}

/// Topic that carries the raw readings of a system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadingsTopic {
    /// Readings that ingest has taken from its source. They are published on request.
    Reading,
    /// Readings of a live source.
    Sensor,
}

impl ReadingsTopic {
    /// Returns the topic on the bus.
    pub const fn topic(self) -> Topic {
        match self {
            Self::Reading => Topic::Reading,
            Self::Sensor => Topic::Sensor,
        }
    }

    /// Decodes a message of the topic. Returns `None` if the bytes have the wrong length.
    pub fn decode(self, bytes: &[u8]) -> Option<Sample> {
        let reading = match self {
            Self::Reading => Reading::from(&try_pod_read_unaligned::<TakenReading>(bytes).ok()?),
            Self::Sensor => Reading::from(try_pod_read_unaligned::<SensorReading>(bytes).ok()?),
        };
        Some(to_sample(&reading))
    }
}

/// Returns the topic that carries the raw readings.
///
/// # Errors
///
/// Returns [`ReadingsError::NotPublished`] if the source is a simulation or recording and the
/// system does not publish its readings.
pub fn readings_topic(config: &ServiceConfig) -> Result<ReadingsTopic, ReadingsError> {
    if config.publishes_readings {
        return Ok(ReadingsTopic::Reading);
    }
    match config.launch.ingest.source {
        Source::Sim | Source::Replay => Err(ReadingsError::NotPublished { system: config.launch.name.clone() }),
        Source::Bus | Source::Stdin | Source::Udp | Source::Tcp | Source::Serial | Source::Mavlink | Source::Iio => {
            Ok(ReadingsTopic::Sensor)
        }
    }
}

/// Copies the calibrations and the meaning of the rate samples (`rate_kind`) from a running system
/// to `prior`.
///
/// # Errors
///
/// Returns an error if a calibration in the launch file is invalid.
pub fn apply_system(prior: &mut Prior, config: &ServiceConfig) -> Result<(), CalibrationError> {
    prior.rate_kind = config.gyro_samples().rate_kind();
    apply_calibrations(prior, &config.launch)
}

/// Copies the calibrations from a launch file to `prior`.
///
/// # Errors
///
/// Returns an error if a calibration in the launch file is invalid.
pub fn apply_calibrations(prior: &mut Prior, launch: &Launch) -> Result<(), CalibrationError> {
    let Calibrations { gyro, accel, mag } = &launch.ingest.calibration;
    (prior.gyro, prior.accel, prior.mag) = (gyro.to_calibration()?, accel.to_calibration()?, mag.to_calibration()?);
    Ok(())
}

/// Converts a reading to a sample for the calibration.
pub fn to_sample(reading: &Reading) -> Sample {
    let Reading { t_ns, rate_rad_s, force_m_s2, field_ut, .. } = *reading;
    Sample { t_ns, rate_rad_s: rate_rad_s.into(), force_m_s2: force_m_s2.into(), field_ut: field_ut.map(Into::into) }
}
