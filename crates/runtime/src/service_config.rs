//! Start-up configuration of a service, and values derived from it.

use std::{fs, path::PathBuf};

use graph::{Buffer, Entry, Participant, Topic};
use launch::{GyroSamples, Launch, MAX_TOPIC_MESSAGES, MIN_TOPIC_MESSAGES, Source};
use serde::{Deserialize, Serialize};
pub use swap::{FIRST_EPOCH, Resume, Role};

use crate::{machine::boot_id, prior::Prior};

/// Speed of the source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Pace {
    /// Fixed speed, in seconds of source time per second of real time.
    Speed(f64),
    /// Highest speed that the slowest subscriber can sustain.
    Max,
}

/// Start-up configuration of a service.
///
/// All services of a system receive the same configuration, except for incarnation, ownership and
/// checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServiceConfig {
    /// Launch file.
    pub launch: Launch,
    /// Absolute path of the launch file; `None` for the built-in one.
    pub launch_file: Option<PathBuf>,
    /// Sample rate in source time, Hz.
    pub rate_hz: f64,
    /// Speed of the source.
    pub pace: Pace,
    /// Number of ticks after which the source ends.
    pub max_ticks: Option<u64>,
    /// `true` if ingest publishes each raw reading.
    pub publishes_readings: bool,
    /// Incarnation of this service.
    pub incarnation: u32,
    /// Epoch of the current decision about the service's slot.
    pub epoch: u32,
    /// Role of the service in its slot: owner or candidate.
    pub role: Role,
    /// Sensor errors estimated in an earlier run. They are used by every incarnation that does not
    /// resume from a later state.
    pub prior: Option<Prior>,
    /// State to resume from; `None` for the first incarnation.
    pub resume: Option<Resume>,
    /// Process identifier of the supervisor. The service stops when this process exits.
    pub supervisor_pid: u32,
}

impl ServiceConfig {
    /// Creates the configuration of a service that owns its slot from the first tick and runs
    /// without a supervisor.
    pub fn standalone(launch: Launch, rate_hz: f64, pace: Pace) -> Self {
        Self {
            launch,
            launch_file: None,
            rate_hz,
            pace,
            max_ticks: None,
            publishes_readings: false,
            incarnation: 0,
            epoch: FIRST_EPOCH,
            role: Role::Owner { from_tick: 0 },
            prior: None,
            resume: None,
            supervisor_pid: 0,
        }
    }

    /// Returns a number that is unique to this run of the system. It is derived from the boot
    /// identifier and from the process identifier and start time of the supervisor.
    pub fn run_id(&self) -> u64 {
        let boot = boot_id();
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.supervisor_pid)).unwrap_or_default();
        // The process name may contain any character, so the fields are counted from its closing
        // parenthesis. The start time is the 20th field after it.
        let start = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(19)).unwrap_or_default();
        messages::hash(messages::HASH_START, format!("{boot} {} {start}", self.supervisor_pid).as_bytes())
    }

    /// Returns the number of messages that a topic buffers for each subscriber.
    pub fn buffer_size(&self, topic: &Entry) -> usize {
        match topic.buffer {
            Buffer::Path => self.buffer_ticks(),
            Buffer::Control => CONTROL_BUFFER,
        }
    }

    /// Returns the number of messages that each topic of the data path buffers.
    pub fn buffer_ticks(&self) -> usize {
        let rate_hz = self.rate_hz * if let Pace::Speed(speed) = self.pace { speed.max(1.0) } else { 1.0 };
        ((rate_hz * self.launch.buffer_s).ceil() as usize).clamp(MIN_TOPIC_MESSAGES, MAX_TOPIC_MESSAGES)
    }

    /// Returns the number of ticks by which another input must be ahead of a missing message before
    /// that message is given up.
    pub fn lateness_ticks(&self) -> u64 {
        ((self.rate_hz * self.launch.lateness_s).ceil() as u64).clamp(2, MAX_TOPIC_MESSAGES as u64)
    }

    /// Returns the number of messages that are read from one input before the others are polled.
    ///
    /// This number is small compared with the lateness, so that a join does not give up an input
    /// that has not been polled yet.
    pub fn batch_size(&self) -> usize {
        (self.lateness_ticks() as usize / 4).clamp(1, MAX_BATCH_SIZE)
    }

    /// Returns the number of ticks between two checkpoints.
    pub fn checkpoint_ticks(&self) -> u64 {
        (self.buffer_ticks() as u64 / CHECKPOINTS_PER_BUFFER).max(1)
    }

    /// Returns the shared memory that the topics need, in bytes.
    ///
    /// The result leaves room for a restarted service. Its new topics exist in addition to those of
    /// its last incarnation.
    pub fn shared_memory_bytes(&self) -> u64 {
        let bytes = |topic: Topic| {
            let entry = topic.entry();
            let publishers = if entry.publisher.is_many() { self.launch.services.len() } else { 1 };
            (messages::size(topic) + MESSAGE_OVERHEAD_BYTES) * self.buffer_size(entry) * publishers
        };
        let has_feeders = !self.launch.ingest.source.is_repeatable();
        let is_published = |topic: &Topic| {
            let has_publisher = has_feeders || topic.entry().publisher != Participant::Feeders;
            if *topic == Topic::Reading { self.publishes_readings } else { has_publisher }
        };
        let bytes: usize = Topic::ALL.iter().copied().filter(is_published).map(bytes).sum();
        (bytes * 3 / 2) as u64
    }

    /// Returns `true` if the source waits for the slowest subscriber, so that no message is
    /// dropped.
    pub fn is_lockstep(&self) -> bool {
        self.launch.ingest.source.is_blocking() || self.pace != Pace::Speed(1.0)
    }

    /// Returns the maximum lead of the source over its slowest subscriber, in ticks.
    ///
    /// The limit is at most half the lateness, so a subscriber with two publishers does not give up
    /// one of them because of this lead. It is also at most half the capacity of a buffer.
    ///
    /// For an import, the limit is halfway between the lateness and the capacity. It must exceed
    /// the lateness, because imported ticks can be lost for good, and a subscriber gives up a lost
    /// tick only once later ticks are ahead of it by the lateness.
    pub fn window_ticks(&self) -> u64 {
        if self.launch.gateway.import.is_some() {
            return (self.buffer_ticks() as u64 + self.lateness_ticks()) / 2;
        }
        (self.lateness_ticks() / 2).min(self.buffer_ticks() as u64 / 2)
    }

    /// Returns the end of the range of ticks that a restarted source publishes without delay.
    ///
    /// The source resumes at `first_tick`, although all ticks before `published_tick` have already
    /// been published. It republishes these without delay if a topic is certain to hold all of them
    /// until they are read.
    pub fn catch_up_end_tick(&self, first_tick: u64, published_tick: u64) -> u64 {
        let held_ticks = self.buffer_ticks() as u64 / if self.is_lockstep() { 1 } else { 2 };
        if published_tick.saturating_sub(first_tick) <= held_ticks { published_tick } else { first_tick }
    }

    /// Returns whether the source's rate samples are means or instantaneous values.
    pub fn gyro_samples(&self) -> GyroSamples {
        match self.launch.ingest.source {
            Source::Sim => self.launch.ingest.sim.gyro_samples(),
            Source::Replay => self.launch.ingest.replay.gyro_samples,
            Source::Bus => self.launch.ingest.bus.gyro_samples,
            _ => self.launch.ingest.stream().map_or(GyroSamples::Means, |stream| stream.gyro_samples),
        }
    }
}

/// Allowance for the data that iceoryx2 stores per message: headers, lists and subscriber buffers.
const MESSAGE_OVERHEAD_BYTES: usize = 128;

/// Number of checkpoints taken while the buffer of a topic fills once.
const CHECKPOINTS_PER_BUFFER: u64 = 32;

/// Maximum number of messages read from one input before the others are polled.
const MAX_BATCH_SIZE: usize = 32;

/// Number of messages that a topic outside the data path buffers per subscriber.
pub const CONTROL_BUFFER: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_batches_of_one_input_stay_within_lateness() {
        for lateness_s in [0.01, 0.05, 0.1, 0.6, 5.0] {
            let launch = Launch { lateness_s, ..Launch::default() };
            let config = ServiceConfig::standalone(launch, 100.0, Pace::Speed(1.0));
            let batch_size = config.batch_size() as u64;
            assert!(batch_size > 0 && 2 * batch_size <= config.lateness_ticks(), "{lateness_s}");
        }
    }
}
