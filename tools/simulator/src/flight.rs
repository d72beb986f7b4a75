//! The flights that are simulated, and their samples.

use std::collections::BTreeMap;

use ingest::{conditioner::Sample, source::Readings};
use launch::{Launch, StageConfig};
use runtime::{Pace, Role, ServiceConfig, service_config::FIRST_EPOCH};

/// Ticks of the longest flight.
pub(crate) const MAX_TICKS: u64 = 600;
/// Samples per second.
pub(crate) const RATE_HZ: f64 = 100.0;
/// How many flights there are.
pub(crate) const FLIGHTS: usize = 4;
/// What fills the slots at first: gyro, accel, fuser, course.
const FILLINGS: [[&str; 4]; FLIGHTS] = [
    ["mobius", "projector", "multiple-model", "angles"],
    ["euler", "inclinometer-matrix", "madgwick", "track"],
    ["mobius", "projector", "aided", "track"],
    ["rk4", "inclinometer-quaternion", "vqf", "angles"],
];

/// A flight.
#[derive(Debug)]
pub(crate) struct Flight {
    /// What runs.
    pub(crate) launch: Launch,
    /// What the sensors said, checked and numbered.
    pub(crate) samples: Vec<Sample>,
}

impl Flight {
    /// The flight of a number, one of [`FLIGHTS`].
    pub(crate) fn new(number: usize) -> Result<Self, String> {
        let [gyro, accel, fuser, course] = FILLINGS[number % FLIGHTS];
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

/// A stage with its defaults.
pub(crate) fn stage(name: &str) -> StageConfig {
    StageConfig { stage: name.into(), set: BTreeMap::new() }
}

/// What a service is told that runs by itself.
pub(crate) fn config(launch: &Launch) -> ServiceConfig {
    ServiceConfig {
        launch: launch.clone(),
        rate_hz: RATE_HZ,
        pace: Pace::Speed(1.0),
        max_ticks: None,
        incarnation: 1,
        epoch: FIRST_EPOCH,
        role: Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: 0,
    }
}
