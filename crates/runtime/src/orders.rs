//! What a service is told when it starts.

use launch::{GyroSamples, Launch, Source, TOPIC_MESSAGES_MAX};
use serde::{Deserialize, Serialize};

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
pub struct Orders {
    /// What runs.
    pub launch: Launch,
    /// Samples per second of the source's time.
    pub rate_hz: f64,
    /// How fast the source goes.
    pub pace: Pace,
    /// Ticks after which the source ends.
    pub ticks_max: Option<u64>,
    /// The life of this service.
    pub incarnation: u32,
    /// The process to end with.
    pub supervisor_pid: u32,
}

impl Orders {
    /// Messages that each topic of the path holds.
    pub fn buffer_ticks(&self) -> usize {
        let rate_hz = self.rate_hz * if let Pace::Speed(speed) = self.pace { speed.max(1.0) } else { 1.0 };
        ((rate_hz * self.launch.buffer_s).ceil() as usize).clamp(BUFFER_MIN, TOPIC_MESSAGES_MAX)
    }

    /// How many ticks another input must be ahead before a missing one is left out.
    pub fn lateness_ticks(&self) -> u64 {
        ((self.rate_hz * self.launch.lateness_s).ceil() as u64).clamp(2, TOPIC_MESSAGES_MAX as u64)
    }

    /// The source waits for the slowest reader: nothing is dropped, whatever the speed.
    pub fn lockstep(&self) -> bool {
        self.launch.ingest.source == Source::Replay || self.pace != Pace::Speed(1.0)
    }

    /// How far the source may be ahead of the last reader in lockstep, ticks: less than what a join or a buffer bears.
    pub fn window_ticks(&self) -> u64 {
        self.lateness_ticks().min(self.buffer_ticks() as u64 / 2)
    }

    /// What a rate sample of the source means.
    pub fn gyro_samples(&self) -> GyroSamples {
        match self.launch.ingest.source {
            Source::Sim => self.launch.ingest.sim.gyro_samples(),
            Source::Replay => self.launch.ingest.replay.gyro_samples,
            Source::Bus => self.launch.ingest.bus.gyro_samples,
        }
    }
}

/// Small enough for a slow sensor, large enough for the burst after a stall.
const BUFFER_MIN: usize = 256;

/// Messages of the topics beside the path that a reader holds.
pub const BUFFER_BESIDE: usize = 64;
