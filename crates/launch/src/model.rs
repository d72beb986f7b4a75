//! Top level of a launch file, `[restart]` and the stages of the slots.

use graph::{Service, Slot, StageConfig};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};

use crate::{
    cockpit::Cockpit,
    description::Key,
    external_stage::{self, ExternalStage},
    gateway::Gateway,
    ingest::Ingest,
    keys::{Kind, choices, keys},
    kind::{By, FileOr, Flag, NAME, NATURAL, Table, choice, many_of},
    north::NorthReference,
    output::Output,
    problem::Problem,
    promotion_rule::{PROMOTION_RULES, PromotionRule},
    slot_stage::{self, UnknownStage},
    toml_reader::Section,
};

/// Maximum of the key `buffer_s`, s. At high rates, the capacity of a topic is lower.
pub(crate) const MAX_BUFFER_S: f64 = 60.0;

keys! {
    /// Declaration of one system.
    pub struct Launch {
        /// Name of the system. Only one running system can have a given name.
        name: String = "plumbline".into(), NAME;
        /// Services in the order in which they are started: every service of the data path once,
        /// and any of the others.
        services: Vec<Service> = Service::LISTED.into(), By(services);
        /// Time span of messages that every topic holds before it overwrites the oldest message.
        buffer_s: f64 = 2.0, 0.1..=MAX_BUFFER_S, unit "s";
        /// Time by which another input must be ahead before a join gives up a missing message. It
        /// must be less than `buffer_s`.
        lateness_s: f64 = 1.0, 0.01..=60.0, unit "s";
        /// File that keeps gyro bias, gyro scale and hard iron when the whole system stops. "auto"
        /// is a file named after the system for live sources except "stdin", and no file for other
        /// sources. `plumb up --cold` ignores the file.
        state_file: StateFile = StateFile::Auto,
            FileOr { auto: StateFile::Auto, off: StateFile::Off, file: StateFile::File };
        /// Restart of services that have exited or that hang.
        restart: Restart = Restart::default(), Table(Restart::read_keys);
        /// `true` if fault injection is allowed, see `[[ingest.fault]]`.
        faults: bool = false, Flag;
        /// Reference frame of attitudes in `--out`, `plumb topic` and the gateway, see
        /// docs/reference/conventions.md.
        output: Output = Output::default(), Table(Output::read_keys);
        /// Telemetry over Zenoh, under the keys `plumbline/v1/VEHICLE/TOPIC`, see
        /// docs/how-to/remote.md.
        gateway: Gateway = Gateway::default(), Table(Gateway::read);
        /// Web page of the system, see docs/how-to/cockpit.md.
        cockpit: Cockpit = Cockpit::default(), Table(Cockpit::read);
        /// Source of the samples, and the limits and calibration that are applied to them.
        ingest: Ingest = Ingest::default(), Table(Ingest::read);
        /// User-defined stage in Rust, C, C++ or Python, see `plumb stage new` and
        /// docs/how-to/own-stage.md.
        stages: BTreeMap<String, ExternalStage> = BTreeMap::new(), By(external_stage::external_stages);
        /// Automatic promotion of a shadow stage. Each slot has at most one rule.
        watch: Vec<PromotionRule> = Vec::new(), PROMOTION_RULES;
        /// Stage of the gyro slot, see docs/reference/stages.md.
        gyro: StageConfig = StageConfig::new(Slot::Gyro.default_stage()), Table(slot_stage::read_keys);
        /// Stage of the accel slot.
        accel: StageConfig = StageConfig::new(Slot::Accel.default_stage()), Table(slot_stage::read_keys);
        /// Stage of the fuser slot. Parameters in `set`: hard_iron_sd_ut for an uncalibrated
        /// magnetometer; antenna_forward_m, antenna_right_m and antenna_up_m for the position of
        /// the receiver's antenna from the sensors.
        fuser: StageConfig = StageConfig::new(Slot::Fuser.default_stage()), Table(slot_stage::read_keys);
        /// Stage of the course slot, and the north reference of the course. The
        /// parameter declination_deg in `set` corrects a magnetic course by a fixed angle.
        course: StageConfig = StageConfig::new(Slot::Course.default_stage()), Table(slot_stage::read_keys);
        /// North reference of the course.
        north as "course": NorthReference = NorthReference::default(), Table(NorthReference::read_keys);
    }
}

/// Location of the state that is kept when the whole system stops.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StateFile {
    /// For live sources other than standard input, a file named after the system in the folder for
    /// state files. For other sources, no file.
    Auto,
    /// No state file.
    Off,
    /// This file, for live sources other than standard input and for simulations in real time.
    File(PathBuf),
}

keys! {
    /// Rules for restarting a service that has exited.
    #[derive(Copy)]
    pub struct Restart {
        /// Time without a health message after which a service is killed and restarted. After a
        /// restart, this time is at least twice the shortest start time of the service so far.
        silence_s: f64 = 0.5, 0.2..=60.0, unit "s";
        /// Run time after which the exit of a process does not count as a failure. Such an exit
        /// resets the failure count.
        min_uptime_s: f64 = 1.0, 0.0..=60.0, unit "s";
        /// Pause before the restart after the second consecutive failure. It doubles with each
        /// further failure.
        backoff_s: f64 = 0.05, 0.0..=60.0, unit "s";
        /// Longest pause before a restart.
        backoff_max_s: f64 = 2.0, 0.0..=600.0, unit "s";
        /// Number of consecutive failures after which the next one is final.
        limit: u64 = 10, NATURAL;
        /// Reaction to the final failure.
        on_limit: OnLimit = OnLimit::Stop, choice();
    }
}

choices! {
    /// Reaction to the final failure of a service.
    #[derive(Eq)]
    pub enum OnLimit {
        /// The system ends.
        Stop = "stop",
        /// The service is not restarted, and the other services continue.
        Degrade = "degrade",
        /// The service is restarted after the longest pause, without limit.
        Retry = "retry",
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

    /// Returns the external stage configured for a slot, or `None` if the slot has a built-in one.
    pub fn external_stage(&self, slot: Slot) -> Option<&ExternalStage> {
        self.stages.get(&self.stage(slot).stage).filter(|stage| stage.slot == slot)
    }

    /// Returns the names of the slot's stages: first built-in, then external ones.
    pub fn stage_names(&self, slot: Slot) -> Vec<&str> {
        slot_stage::stage_names(slot, &self.stages)
    }

    /// Checks that the slot has a stage of this name, built-in or external.
    ///
    /// # Errors
    ///
    /// Returns an error with the slot's stages if the name is unknown or belongs to another slot.
    pub fn validate_stage(&self, slot: Slot, stage: &str) -> Result<(), UnknownStage> {
        slot_stage::validate(slot, stage, &self.stages)
    }

    /// Adds or removes the service `drivers`, depending on whether the source or a receiver needs
    /// it.
    pub(crate) fn add_drivers(&mut self) {
        self.services.retain(|service| *service != Service::Drivers);
        let Ingest { source, live, .. } = &self.ingest;
        // Simulations and recordings have their own time and fixes, so a receiver is not used.
        let has_receiver = live.receiver.port.is_some() && !source.is_repeatable();
        if (source.needs_drivers() || has_receiver) && self.services.contains(&Service::Ingest) {
            self.services.push(Service::Drivers);
        }
    }
}

/// Reads `services`, and reports repeated services.
fn services(section: &mut Section<'_, '_>, key: Key, out: &mut Vec<Service>) {
    many_of(Service::LISTED.map(|service| (service.name(), service))).read(section, key, out);
    let listed = section.elements(key.name);
    for (index, (name, span)) in listed.iter().enumerate() {
        let is_known = Service::LISTED.iter().any(|service| service.name() == *name);
        if let Some((_, first)) = listed[..index].iter().find(|(earlier, _)| earlier == name && is_known) {
            section.report(Problem {
                context: Some((first.clone(), "first listed here".into())),
                ..Problem::new(span.clone(), format!("services: \"{name}\" is listed twice"), "listed again")
            });
        }
    }
}
