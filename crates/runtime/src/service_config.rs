//! What a service is told when it starts.

use graph::{Buffer, Entry, Participant, Topic};
use launch::{GyroSamples, Launch, Source, TOPIC_MESSAGES_MAX};
use messages::Checkpoint;
use serde::{Deserialize, Serialize};
pub use swap::{FIRST_EPOCH, Role};

use crate::prior::Prior;

/// How fast the source goes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Pace {
    /// Seconds of the source per second of the clock.
    Speed(f64),
    /// As fast as the slowest reader.
    Max,
}

/// What a service is told when it starts: the same for every service of a system but for its incarnation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServiceConfig {
    /// What runs.
    pub launch: Launch,
    /// Samples per second of the source's time.
    pub rate_hz: f64,
    /// How fast the source goes.
    pub pace: Pace,
    /// Ticks after which the source ends.
    pub ticks_max: Option<u64>,
    /// Ingest publishes each reading as it came.
    pub readings: bool,
    /// The incarnation of this service.
    pub incarnation: u32,
    /// The decision about its slot that is in force.
    pub epoch: u32,
    /// Whether it owns its slot.
    pub role: Role,
    /// What an earlier run has found of the sensors; every incarnation begins with it that does not go on from a later state.
    pub prior: Option<Prior>,
    /// From where it goes on, if it is not its first incarnation.
    pub resume: Option<Resume>,
    /// The process to end with.
    pub supervisor_pid: u32,
}

impl ServiceConfig {
    /// Messages that a topic holds for each reader.
    pub fn buffer(&self, topic: &Entry) -> usize {
        match topic.buffer {
            Buffer::Path => self.buffer_ticks(),
            Buffer::Control => BUFFER_BESIDE,
        }
    }

    /// Messages that each topic of the path holds.
    pub fn buffer_ticks(&self) -> usize {
        let rate_hz = self.rate_hz * if let Pace::Speed(speed) = self.pace { speed.max(1.0) } else { 1.0 };
        ((rate_hz * self.launch.buffer_s).ceil() as usize).clamp(BUFFER_MIN, TOPIC_MESSAGES_MAX)
    }

    /// How many ticks another input must be ahead before a missing one is left out.
    pub fn lateness_ticks(&self) -> u64 {
        ((self.rate_hz * self.launch.lateness_s).ceil() as u64).clamp(2, TOPIC_MESSAGES_MAX as u64)
    }

    /// Messages of one input that a slot takes before the others have their turn: few against the lateness, so that a join does not take
    /// another input for silent that it has not looked at.
    pub fn turn(&self) -> usize {
        (self.lateness_ticks() as usize / 4).clamp(1, TURN_MAX)
    }

    /// Ticks from one checkpoint to the next.
    pub fn checkpoint_ticks(&self) -> u64 {
        (self.buffer_ticks() as u64 / CHECKPOINTS_PER_BUFFER).max(1)
    }

    /// What the topics fill of shared memory when a service that was started again has its own beside those of its last incarnation, bytes.
    pub fn shared_memory_bytes(&self) -> u64 {
        let bytes = |topic: Topic| {
            let entry = topic.entry();
            let publishers = if entry.publisher.is_many() { self.launch.services.len() } else { 1 };
            (messages::size(topic) + MESSAGE_OVERHEAD_BYTES) * self.buffer(entry) * publishers
        };
        let from_feeders = !self.launch.ingest.source.can_be_read_again();
        let is_there = |topic: &Topic| match topic {
            Topic::Reading => self.readings,
            topic => from_feeders || topic.entry().publisher != Participant::Feeders,
        };
        let bytes: usize = Topic::ALL.iter().copied().filter(is_there).map(bytes).sum();
        (bytes * 3 / 2) as u64
    }

    /// The source waits for the slowest reader: nothing is dropped, whatever the speed.
    pub fn lockstep(&self) -> bool {
        self.launch.ingest.source.waits() || self.pace != Pace::Speed(1.0)
    }

    /// How far the source may be ahead of the last reader, ticks: in lockstep no more than what a reader of two
    /// publishers waits for one of them, and less than what a buffer bears; for an import, of
    /// which something may be missing for good, less than a buffer bears.
    pub fn window_ticks(&self) -> u64 {
        if self.launch.gateway.import.is_some() {
            return (self.buffer_ticks() as u64 + self.lateness_ticks()) / 2;
        }
        (self.lateness_ticks() / 2).min(self.buffer_ticks() as u64 / 2)
    }

    /// Up to which tick a source that was started again with `first_tick` gives at once what had been published before `published`: all of
    /// it, where a topic surely holds that much until it is read.
    pub fn again_until(&self, first_tick: u64, published: u64) -> u64 {
        let held_ticks = self.buffer_ticks() as u64 / if self.lockstep() { 1 } else { 2 };
        if published.saturating_sub(first_tick) <= held_ticks { published } else { first_tick }
    }

    /// What a rate sample of the source means.
    pub fn gyro_samples(&self) -> GyroSamples {
        match self.launch.ingest.source {
            Source::Sim => self.launch.ingest.sim.gyro_samples(),
            Source::Replay => self.launch.ingest.replay.gyro_samples,
            Source::Bus => self.launch.ingest.bus.gyro_samples,
            _ => self.launch.ingest.stream().map_or(GyroSamples::Means, |stream| stream.gyro_samples),
        }
    }
}

/// From where a service goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Resume {
    /// From the beginning of what its inputs still hold: no checkpoint was made.
    Fresh,
    /// From the state of an earlier incarnation, or of another stage.
    Checkpoint(Box<Record>),
    /// The source, from this tick on; its first reading was due at this time of CLOCK_MONOTONIC, ns.
    Source {
        /// The next tick.
        next_tick: u64,
        /// When the first tick was due, ns; 0 when none has been.
        start_ns: u64,
        /// Time of the samples less the sensor's, ns.
        offset_ns: i64,
    },
}

/// A checkpoint as text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Record(Vec<u64>);

impl From<&Checkpoint> for Record {
    fn from(checkpoint: &Checkpoint) -> Self {
        Self(bytemuck::cast_slice(std::slice::from_ref(checkpoint)).to_vec())
    }
}

impl Record {
    /// The checkpoint, if it has the right length.
    pub fn checkpoint(&self) -> Option<Checkpoint> {
        bytemuck::try_cast_slice::<u64, Checkpoint>(&self.0).ok()?.first().copied()
    }
}

/// What iceoryx2 has beside each message, in its heads, lists and the buffers of readers.
const MESSAGE_OVERHEAD_BYTES: usize = 128;

/// Checkpoints while a topic's buffer fills once.
const CHECKPOINTS_PER_BUFFER: u64 = 32;

/// Messages of one input taken before the others have their turn, at most.
const TURN_MAX: usize = 32;

/// Small enough for a slow sensor, large enough for the burst after a stall.
const BUFFER_MIN: usize = 256;

/// Messages of the topics beside the path that a reader holds.
pub const BUFFER_BESIDE: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_turns_of_an_input_do_not_make_another_late() {
        for lateness_s in [0.01, 0.05, 0.1, 0.6, 5.0] {
            let config = ServiceConfig {
                launch: Launch { lateness_s, ..Launch::default() },
                rate_hz: 100.0,
                pace: Pace::Speed(1.0),
                ticks_max: None,
                incarnation: 1,
                epoch: FIRST_EPOCH,
                role: Role::Owner { from_tick: 0 },
                prior: None,
                resume: None,
                readings: false,
                supervisor_pid: 0,
            };
            let turn = config.turn() as u64;
            assert!(turn > 0 && 2 * turn <= config.lateness_ticks(), "{lateness_s}");
        }
    }
}
