//! Contents of a launch file, and the defaults.

use attitude::{
    Matrix3,
    calibration::{self, CalibrationError},
    gyro::RateKind,
};
use graph::{Service, Slot, StageConfig};
use scenario::{Scenario, ScenarioError};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};

use crate::{
    cockpit::Cockpit, external_stage::ExternalStage, fault::Fault, gateway::Gateway, live_sources::LiveSources,
    north::NorthReference, output::Output, promotion_rule::PromotionRule,
};

/// Maximum number of messages that a topic holds for a subscriber: 13 MB for the largest message
/// type.
pub const MAX_TOPIC_MESSAGES: usize = 65_536;

/// Declaration of one system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Launch {
    /// Name of the system: 1 to 32 characters from a–z, 0–9, `_` and `-`. Only one running system
    /// can have a given name.
    pub name: String,
    /// Services in the order in which they are started: every service of the data path once, and
    /// optional ones.
    pub services: Vec<Service>,
    /// Time span of messages that every topic holds before it overwrites the oldest message, s.
    pub buffer_s: f64,
    /// Lead of one input at which a join gives up a missing message of another input, s. It must be
    /// less than `buffer_s`.
    pub lateness_s: f64,
    /// Location of the state that is kept when the whole system stops.
    pub state_file: StateFile,
    /// Rules for restarting services.
    pub restart: Restart,
    /// `true` if fault injection is allowed.
    pub faults: bool,
    /// Reference frame of published attitudes.
    pub output: Output,
    /// Settings of the gateway, if it is among the services.
    pub gateway: Gateway,
    /// Settings of the cockpit, if it is among the services.
    pub cockpit: Cockpit,
    /// Source of the samples, and the limits and calibration that are applied to them.
    pub ingest: Ingest,
    /// User-defined stages by name.
    pub stages: BTreeMap<String, ExternalStage>,
    /// Rules for automatic promotion, at most one per slot.
    pub watch: Vec<PromotionRule>,
    /// Stage of the gyro slot, one of `attitude::gyro::Gyro::NAMES` or of `stages`.
    pub gyro: StageConfig,
    /// Stage of the accel slot, one of `attitude::accel::Accelerometer::NAMES` or of `stages`.
    pub accel: StageConfig,
    /// Stage of the fuser slot, one of `attitude::fuser::Fuser::NAMES` or of `stages`.
    pub fuser: StageConfig,
    /// Stage of the course slot, one of `attitude::course::Course::NAMES` or of `stages`.
    pub course: StageConfig,
    /// North reference of the course.
    pub north: NorthReference,
}

/// Location of the state that is kept when the whole system stops.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StateFile {
    /// For live sources other than standard input, a file named after the system in the folder for
    /// state files. For other sources, no file.
    Auto,
    /// No state file.
    Off,
    /// This file, also for a simulation in real time. [`Launch::read`] makes a relative path
    /// relative to the launch file's folder.
    File(PathBuf),
}

/// Rules for restarting a service that has exited.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Restart {
    /// Time without a health message after which a service is killed and restarted, s.
    pub silence_s: f64,
    /// Minimum run time of a process for its exit not to count as a failure, s. Such an exit resets
    /// the failure count.
    pub min_uptime_s: f64,
    /// Pause before the restart after the second consecutive failure, s. It doubles with each
    /// further failure.
    pub backoff_s: f64,
    /// Longest pause before a restart, s.
    pub backoff_max_s: f64,
    /// Number of consecutive failures after which the next one is final.
    pub limit: u64,
    /// Reaction to the final failure.
    pub on_limit: OnLimit,
}

/// Reaction to the final failure of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum OnLimit {
    /// The system ends.
    Stop,
    /// The service is not restarted, and the other services continue.
    Degrade,
    /// The service is restarted after the longest pause, without limit.
    Retry,
}

/// Source of the samples, and the limits, calibration, mounting and faults that are applied to
/// them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ingest {
    /// Selected source.
    pub source: Source,
    /// Settings of simulated sensors.
    pub sim: Sim,
    /// Settings for replaying a recorded flight.
    pub replay: Replay,
    /// Settings of samples published on the bus by another process.
    pub bus: BusSource,
    /// Settings of sources that send in real time.
    pub live: LiveSources,
    /// Limits beyond which samples are flagged.
    pub limits: Limits,
    /// Calibration of each sensor, in sensor axes.
    pub calibration: Calibrations,
    /// Rotation matrix from sensor axes to body axes, v_body = M v_sensor, row by row.
    pub mounting: [[f64; 3]; 3],
    /// Injected faults in the order in which they are applied, at most
    /// [`MAX_FAULTS`](crate::MAX_FAULTS).
    pub faults: Vec<Fault>,
}

/// Calibrations of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Calibrations {
    /// Calibration from raw units to rad/s.
    pub gyro: Calibration,
    /// Calibration from raw units to m/s².
    pub accel: Calibration,
    /// Calibration from raw units to µT.
    pub mag: Calibration,
}

/// Calibration of a sensor with three axes: out = M (raw − bias).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Bias in raw units.
    pub bias: [f64; 3],
    /// Matrix in SI units (µT for fields) per raw unit, row by row.
    pub matrix: [[f64; 3]; 3],
}

impl Default for Calibration {
    fn default() -> Self {
        Self { bias: [0.0; 3], matrix: IDENTITY }
    }
}

impl Calibration {
    /// Converts these values to a calibration that can be applied to readings.
    ///
    /// # Errors
    ///
    /// Returns an error if the values are not a valid calibration.
    pub fn to_calibration(&self) -> Result<calibration::Calibration, CalibrationError> {
        let matrix = Matrix3::from_fn(|row, column| self.matrix[row][column]);
        calibration::Calibration::new(self.bias.into(), matrix)
    }
}

/// Identity matrix.
pub(crate) const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Settings of simulated sensors on a moving body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sim {
    /// Name of the motion, one of `scenario::Motion::NAMES`.
    pub scenario: String,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Seed of the noise, at most `i64::MAX`. The same seed gives the same samples.
    pub seed: u64,
    /// Parameters that override those of the scenario, keyed by the names in
    /// `scenario::PARAMETERS`.
    #[serde(default)]
    pub set: BTreeMap<String, f64>,
}

impl Sim {
    /// Returns the scenario with all parameters applied.
    ///
    /// # Errors
    ///
    /// Returns an error if the scenario or a parameter is unknown or not allowed.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        let mut scenario = Scenario::parse(&self.scenario)?.with_seed(self.seed).with_rate_hz(self.rate_hz);
        self.set.iter().try_for_each(|(name, value)| scenario.set(name, *value))?;
        Ok(scenario)
    }

    /// Returns the kind of rate sample that the scenario produces.
    pub fn gyro_samples(&self) -> GyroSamples {
        match Scenario::parse(&self.scenario).map(|scenario| scenario.rate_kind) {
            Ok(RateKind::Mean) => GyroSamples::Means,
            _ => GyroSamples::Instants,
        }
    }
}

/// Settings for replaying a recorded flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    /// Path of the recording, empty if not set. [`Launch::read`] makes a relative path relative to
    /// the launch file's folder.
    pub file: PathBuf,
    /// Kind of rate sample: the mean over its interval, or the value at the end.
    pub gyro_samples: GyroSamples,
    /// `true` if the magnetometer columns are used.
    pub mag: bool,
    /// Location of the satellite receiver's fixes.
    pub gnss: Gnss,
}

/// Location of the fixes of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gnss {
    /// `NAME_gnss.csv` in the folder of `NAME_imu.csv` or `NAME_imu.csv.gz`, if it exists.
    Auto,
    /// No fixes.
    Off,
    /// This file.
    File(PathBuf),
}

/// Settings of samples published on the bus by another process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BusSource {
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Kind of rate sample: the mean over its interval, or the value at the end.
    pub gyro_samples: GyroSamples,
}

/// Limits beyond which samples are flagged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Rate at and beyond which a sample is flagged as clipped, °/s.
    pub rate_max_deg_s: f64,
    /// Specific force at and beyond which a sample is flagged as clipped, g.
    pub force_max_g: f64,
    /// Longest interval between samples that is not flagged as a gap, s.
    pub gap_s: f64,
    /// Time after which a sensor with constant output is flagged as stuck, s.
    pub stuck_s: f64,
    /// Component of the magnetic field at and beyond which the field sample is rejected, µT.
    pub field_max_ut: f64,
}

/// Source of samples.
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
    /// UDP datagrams.
    Udp,
    /// TCP connection.
    Tcp,
    /// Serial line.
    Serial,
    /// Autopilot over MAVLink.
    Mavlink,
    /// Device of Linux industrial I/O.
    Iio,
}

/// Kind of rate sample, in relation to its sampling interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GyroSamples {
    /// Mean over the interval.
    Means,
    /// Value at the end of the interval.
    Instants,
}

impl GyroSamples {
    /// All values with their names.
    pub(crate) const ALL: [(&str, Self); 2] = [("means", Self::Means), ("instants", Self::Instants)];

    /// Returns the corresponding [`RateKind`] for the stages.
    pub fn rate_kind(self) -> RateKind {
        match self {
            Self::Means => RateKind::Mean,
            Self::Instants => RateKind::Instant,
        }
    }
}

impl Default for Launch {
    fn default() -> Self {
        let stage = |name: &str| StageConfig { stage: name.into(), set: BTreeMap::new() };
        Self {
            name: "plumbline".into(),
            services: Service::PATH.into(),
            buffer_s: 2.0,
            lateness_s: 1.0,
            state_file: StateFile::Auto,
            restart: Restart {
                silence_s: 0.5,
                min_uptime_s: 1.0,
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
                live: LiveSources::default(),
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
            north: NorthReference::default(),
        }
    }
}

impl Launch {
    /// Returns the stage of a slot.
    pub fn stage(&self, slot: Slot) -> &StageConfig {
        match slot {
            Slot::Gyro => &self.gyro,
            Slot::Accel => &self.accel,
            Slot::Fuser => &self.fuser,
            Slot::Course => &self.course,
        }
    }

    /// Returns the stage of a slot for modification.
    pub fn stage_mut(&mut self, slot: Slot) -> &mut StageConfig {
        match slot {
            Slot::Gyro => &mut self.gyro,
            Slot::Accel => &mut self.accel,
            Slot::Fuser => &mut self.fuser,
            Slot::Course => &mut self.course,
        }
    }
}

/// Accepts a name of 1 to 32 characters from a–z, 0–9, `_` and `-`.
pub(crate) fn system_name(name: &str) -> Option<String> {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    ((1..=32).contains(&name.len()) && name.bytes().all(allowed)).then(|| name.into())
}
