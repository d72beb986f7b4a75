//! Flights to simulate, and their samples.

use std::collections::BTreeMap;

use ingest::{conditioner::Sample, source::Readings};
use launch::{Launch, StageConfig};
use runtime::{Pace, ServiceConfig, service_config::FIRST_EPOCH};

/// Number of ticks of the longest flight.
pub(crate) const MAX_TICKS: u64 = 600;
/// Sample rate, Hz.
pub(crate) const RATE_HZ: f64 = 100.0;
/// Number of flights.
pub(crate) const FLIGHT_COUNT: usize = 4;
/// Initial stages of each flight: gyro, accel, fuser, course.
const INITIAL_STAGES: [[&str; 4]; FLIGHT_COUNT] = [
    ["mobius", "projector", "multiple-model", "angles"],
    ["euler", "inclinometer-matrix", "madgwick", "track"],
    ["mobius", "projector", "aided", "track"],
    ["rk4", "inclinometer-quaternion", "vqf", "angles"],
];

/// Flight to simulate.
#[derive(Debug)]
pub(crate) struct Flight {
    /// Launch configuration.
    pub(crate) launch: Launch,
    /// Samples in tick order, checked and numbered by ingest.
    pub(crate) samples: Vec<Sample>,
}

impl Flight {
    /// Creates the flight with this number, modulo [`FLIGHT_COUNT`].
    pub(crate) fn new(number: usize) -> Result<Self, String> {
        let [gyro, accel, fuser, course] = INITIAL_STAGES[number % FLIGHT_COUNT];
        let mut launch = Launch::default();
        launch.ingest.sim.scenario = "cruise".into();
        launch.ingest.sim.rate_hz = RATE_HZ;
        launch.restart.limit = 30;
        (launch.gyro, launch.accel) = (stage(gyro), stage(accel));
        (launch.fuser, launch.course) = (stage(fuser), stage(course));
        let config = config(&launch);
        let mut conditioner = ingest::conditioner(&config).map_err(|error| error.to_string())?;
        let readings = Readings::open(&launch).map_err(|error| error.to_string())?;
        let readings = readings.take(MAX_TICKS as usize + 1).filter_map(Result::ok);
        let mut samples: Vec<_> = readings.filter_map(|reading| conditioner.condition(&reading)).collect();
        samples.iter_mut().for_each(|sample| sample.imu.header.epoch = FIRST_EPOCH);
        Ok(Self { launch, samples })
    }
}

/// Returns a stage with default settings.
pub(crate) fn stage(name: &str) -> StageConfig {
    StageConfig { stage: name.into(), set: BTreeMap::new() }
}

/// Returns the configuration of a stand-alone service that owns its slot.
pub(crate) fn config(launch: &Launch) -> ServiceConfig {
    ServiceConfig { incarnation: 1, ..ServiceConfig::standalone(launch.clone(), RATE_HZ, Pace::Speed(1.0)) }
}
