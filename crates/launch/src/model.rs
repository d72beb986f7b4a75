//! What a launch file says, and the defaults.

use attitude::{
    Matrix3,
    calibration::{self, CalibrationError},
    gyro::RateKind,
};
use graph::Service;
use scenario::{Scenario, ScenarioError};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};

use crate::{
    cockpit::Cockpit, fault::Fault, gateway::Gateway, live::Live, north::North, output::Output, program::Program,
    watch::Watch,
};

/// Messages that a topic holds for a reader at most: 13 MB of the largest.
pub const TOPIC_MESSAGES_MAX: usize = 65_536;

/// One running system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Launch {
    /// The system's name, 1 to 32 of a–z, 0–9, `_` and `-`; one running system per name.
    pub name: String,
    /// Every service of the data path once, and what is to run beside it, in the order they are started.
    pub services: Vec<Service>,
    /// How much every topic holds before its oldest sample is overwritten, s.
    pub buffer_s: f64,
    /// How far ahead of a missing input another must be for a join to go on without it, s; less than `buffer_s`.
    pub lateness_s: f64,
    /// Where what outlives a stop of the whole system is kept.
    pub state_file: StateFile,
    /// When a service that ended is started again, and when no more.
    pub restart: Restart,
    /// A script of faults is allowed.
    pub faults: bool,
    /// In which frame the attitude leaves the system.
    pub output: Output,
    /// What goes beyond the board, if the gateway is among the services.
    pub gateway: Gateway,
    /// Where the system is shown, if the cockpit is among the services.
    pub cockpit: Cockpit,
    /// Where samples come from, and what is wrong with a sample.
    pub ingest: Ingest,
    /// Programs of the user's own that may fill a slot, by name.
    pub stages: BTreeMap<String, Program>,
    /// Stages that take over by themselves; one of each slot at most.
    pub watch: Vec<Watch>,
    /// Which of `attitude::gyro::Gyro::NAMES` runs.
    pub gyro: Stage,
    /// Which of `attitude::accel::Accelerometer::NAMES` runs.
    pub accel: Stage,
    /// Which of `attitude::fuser::Fuser::NAMES` runs.
    pub fuser: Stage,
    /// Which of `attitude::course::Course::NAMES` runs.
    pub course: Stage,
    /// From which north its course is counted.
    pub north: North,
}

/// Where what outlives a stop of the whole system is kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StateFile {
    /// With sensors on the bus in a file of the system's name, in the folder that is the user's for such files; else nowhere.
    Auto,
    /// Nowhere.
    Off,
    /// In this file, of a simulation in real time too. [`Launch::read`] has put the launch file's folder before a relative path.
    File(PathBuf),
}

/// When a service that ended is started again, and when no more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Restart {
    /// A service that says nothing for so long is killed and started again, s.
    pub silence_s: f64,
    /// An incarnation shorter than this counts as a failure, a longer one clears the count, s.
    pub settled_s: f64,
    /// The pause before the third incarnation in a row that follows a failure; it doubles with each, s.
    pub backoff_s: f64,
    /// The longest pause, s.
    pub backoff_max_s: f64,
    /// After more failures in a row than this the service has failed.
    pub limit: u64,
    /// What happens then.
    pub on_limit: OnLimit,
}

/// What happens when a service has failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum OnLimit {
    /// The system ends.
    Stop,
    /// The service stays away; the others go on with what there is.
    Degrade,
    /// It is tried again after the longest pause, without end.
    Hold,
}

/// What fills a slot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// The stage's name: one of the slot's `NAMES`, or of [`Launch::stages`].
    pub stage: String,
    /// Its parameters that are not to have their defaults, by name.
    pub set: BTreeMap<String, f64>,
}

/// Where samples come from, and what is wrong with a sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ingest {
    /// Which of the sources below is used.
    pub source: Source,
    /// The simulated sensors.
    pub sim: Sim,
    /// The recorded flight.
    pub replay: Replay,
    /// The samples another process publishes.
    pub bus: BusSource,
    /// What is read while it is sent.
    pub live: Live,
    /// What is flagged.
    pub limits: Limits,
    /// What the sensors' readings are in the sensors' axes.
    pub calibration: Calibrations,
    /// The rotation from the sensors' axes to the body's, v_body = M v_sensor, row by row.
    pub mounting: [[f64; 3]; 3],
    /// What the sensors are made to do wrong, in the order in which it is done to a reading; [`FAULTS_MAX`](crate::FAULTS_MAX) at most.
    pub faults: Vec<Fault>,
}

/// The calibration of each sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Calibrations {
    /// Raw to rad/s.
    pub gyro: Calibration,
    /// Raw to m/s².
    pub accel: Calibration,
    /// Raw to µT.
    pub mag: Calibration,
}

/// The calibration of a sensor with three axes: out = M (raw − bias).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// In raw units.
    pub bias: [f64; 3],
    /// SI units (µT) per raw unit, row by row.
    pub matrix: [[f64; 3]; 3],
}

impl Default for Calibration {
    fn default() -> Self {
        Self { bias: [0.0; 3], matrix: IDENTITY }
    }
}

impl Calibration {
    /// It as what acts on readings.
    pub fn acting(&self) -> Result<calibration::Calibration, CalibrationError> {
        let matrix = Matrix3::from_fn(|row, column| self.matrix[row][column]);
        calibration::Calibration::new(self.bias.into(), matrix)
    }
}

/// No turn, no scale.
pub(crate) const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Simulated sensors on a body in motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sim {
    /// The motion, one of `scenario::Motion::NAMES`.
    pub scenario: String,
    /// Samples per second, Hz.
    pub rate_hz: f64,
    /// Seed of the noise; the same seed gives the same samples. At most `i64::MAX`.
    pub seed: u64,
    /// What is otherwise than in the scenario, by the names of `scenario::PARAMETERS`.
    #[serde(default)]
    pub set: BTreeMap<String, f64>,
}

impl Sim {
    /// The scenario as it is set.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        let mut scenario = Scenario::named(&self.scenario)?.with_seed(self.seed).with_rate_hz(self.rate_hz);
        self.set.iter().try_for_each(|(name, value)| scenario.set(name, *value))?;
        Ok(scenario)
    }

    /// What a rate sample of the scenario says about its interval.
    pub fn gyro_samples(&self) -> GyroSamples {
        match Scenario::named(&self.scenario).map(|scenario| scenario.rate_kind) {
            Ok(RateKind::Mean) => GyroSamples::Means,
            _ => GyroSamples::Instants,
        }
    }
}

/// A recorded flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    /// The recording; empty if none is named. [`Launch::read`] has put the launch file's folder before a relative path.
    pub file: PathBuf,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
    /// The magnetometer's columns are used.
    pub mag: bool,
    /// Where the satellite receiver's fixes are.
    pub gnss: Gnss,
}

/// Where the fixes that go with a recording are.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gnss {
    /// In `NAME_gnss.csv` beside `NAME_imu.csv` or `NAME_imu.csv.gz`, if that is there.
    Auto,
    /// Nowhere.
    Off,
    /// In this file.
    File(PathBuf),
}

/// Samples that another process publishes on the bus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BusSource {
    /// Nominal samples per second, Hz.
    pub rate_hz: f64,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
}

/// What is flagged in the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// A rate at or beyond it is flagged as clipped, °/s.
    pub rate_max_deg_s: f64,
    /// A specific force at or beyond it is flagged as clipped, g.
    pub force_max_g: f64,
    /// A longer interval between samples is flagged as a gap, s.
    pub gap_s: f64,
    /// A sensor that repeats itself for so long is flagged as stuck, s.
    pub stuck_s: f64,
    /// A component of the magnetic field at or beyond it makes the sample worthless, µT.
    pub field_max_ut: f64,
}

/// Where samples come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Simulated sensors.
    Sim,
    /// A recorded flight.
    Replay,
    /// Another process, over the bus.
    Bus,
    /// Standard input of the supervisor.
    Stdin,
    /// Datagrams.
    Udp,
    /// A connection.
    Tcp,
    /// A serial line.
    Serial,
    /// An autopilot.
    Mavlink,
    /// A device of Linux industrial I/O.
    Iio,
}

/// What a rate sample says about its interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GyroSamples {
    /// The mean over the interval.
    Means,
    /// The value at the interval's end.
    Instants,
}

impl GyroSamples {
    /// Both with their names.
    pub(crate) const ALL: [(&str, Self); 2] = [("means", Self::Means), ("instants", Self::Instants)];

    /// The same to the stages.
    pub fn rate_kind(self) -> RateKind {
        match self {
            Self::Means => RateKind::Mean,
            Self::Instants => RateKind::Instant,
        }
    }
}

impl Default for Launch {
    fn default() -> Self {
        let stage = |name: &str| Stage { stage: name.into(), set: BTreeMap::new() };
        Self {
            name: "plumbline".into(),
            services: Service::PATH.into(),
            buffer_s: 2.0,
            lateness_s: 1.0,
            state_file: StateFile::Auto,
            restart: Restart {
                silence_s: 0.5,
                settled_s: 1.0,
                backoff_s: 0.05,
                backoff_max_s: 2.0,
                limit: 10,
                on_limit: OnLimit::Stop,
            },
            faults: false,
            output: Output::default(),
            gateway: Gateway::default(),
            cockpit: Cockpit::default(),
            ingest: Ingest {
                source: Source::Sim,
                sim: Sim { scenario: "s1".into(), rate_hz: 1000.0, seed: 1, set: BTreeMap::new() },
                replay: Replay { file: PathBuf::new(), gyro_samples: GyroSamples::Means, mag: true, gnss: Gnss::Auto },
                bus: BusSource { rate_hz: 1000.0, gyro_samples: GyroSamples::Means },
                live: Live::default(),
                limits: Limits {
                    rate_max_deg_s: 2000.0,
                    force_max_g: 16.0,
                    gap_s: 0.1,
                    stuck_s: 0.5,
                    field_max_ut: 2000.0,
                },
                calibration: Calibrations::default(),
                mounting: IDENTITY,
                faults: Vec::new(),
            },
            stages: BTreeMap::new(),
            watch: Vec::new(),
            gyro: stage("mobius"),
            accel: stage("projector"),
            fuser: stage("multiple-model"),
            course: stage("angles"),
            north: North::default(),
        }
    }
}

impl Launch {
    /// What fills a slot; `None` for a service that has no stage.
    pub fn slot(&self, service: Service) -> Option<&Stage> {
        match service {
            Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => None,
            Service::Gyro => Some(&self.gyro),
            Service::Accel => Some(&self.accel),
            Service::Fuser => Some(&self.fuser),
            Service::Course => Some(&self.course),
        }
    }

    /// What fills a slot, to be swapped.
    pub fn slot_mut(&mut self, service: Service) -> Option<&mut Stage> {
        match service {
            Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => None,
            Service::Gyro => Some(&mut self.gyro),
            Service::Accel => Some(&mut self.accel),
            Service::Fuser => Some(&mut self.fuser),
            Service::Course => Some(&mut self.course),
        }
    }
}

/// A name of 1 to 32 of a–z, 0–9, `_` and `-`.
pub(crate) fn system_name(name: &str) -> Option<String> {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    ((1..=32).contains(&name.len()) && name.bytes().all(allowed)).then(|| name.into())
}
