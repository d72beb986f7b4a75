//! Readings of a source, and their conversion to checked samples.
//!
//! Input: a simulation, a recording, or readings that the service `ingest` receives.
//!
//! Output: samples, numbered by tick.
//!
//! Time: the timestamps of the readings.
//!
//! Failure: see [`mod@conditioner`].
//!
//! | module | contents |
//! | --- | --- |
//! | [`source`] | simulations and recordings as sources of readings |
//! | [`mod@conditioner`] | conversion of readings to samples |
//! | `fault_injection` | faults that the launch file injects |
//! | `raw_readings` | readings as messages, for the replay of a flight |
//! | [`flight_replay`] | samples of a flight from its recorded readings |
#![forbid(unsafe_code)]

pub mod conditioner;
mod fault_injection;
pub mod flight_replay;
mod raw_readings;
pub mod source;

use runtime::ServiceConfig;

use conditioner::Conditioner;
use source::SourceError;

/// Creates the conditioner for the source that `config` names.
///
/// # Errors
///
/// Returns an error if a calibration or the mounting is invalid.
pub fn conditioner(config: &ServiceConfig) -> Result<Conditioner, SourceError> {
    Ok(Conditioner::new(&config.launch.ingest, config.rate_hz, config.gyro_samples())?)
}
