//! Warnings about implausible input, computed in parallel with the data path.
//!
//! - Input: samples as published by ingest.
//! - Output: warnings.
//! - Time: sample time.
//! - Failure: a sample that cannot be read is not checked. The data path never waits for the check.

use bus::{Bus, BusError, Subscriber};
use judge::{Diagnosis, FieldQueue, InputCheck};
use launch::TickSource;
use messages::{ImuSample, MagSample};
use runtime::ServiceConfig;

/// Input check with the warnings given so far.
#[derive(Debug, Default)]
pub(crate) struct InputChecker {
    checker: InputCheck,
    warnings: Vec<String>,
}

impl InputChecker {
    /// Checks a sample, with its magnetic field if present, and returns new warnings to announce.
    pub(crate) fn check(&mut self, imu: &ImuSample, mag: Option<&MagSample>) -> Vec<String> {
        let diagnoses = self.checker.update(imu, mag);
        self.record(&diagnoses)
    }

    /// Finishes the check and returns the remaining warnings.
    pub(crate) fn finish(&mut self) -> Vec<String> {
        let diagnoses = self.checker.finish();
        self.record(&diagnoses)
    }

    /// Returns `true` once no further warnings can follow.
    pub(crate) fn is_finished(&self) -> bool {
        self.checker.is_finished()
    }

    /// Returns all warnings.
    pub(crate) fn into_warnings(self) -> Vec<String> {
        self.warnings
    }

    fn record(&mut self, diagnoses: &[Diagnosis]) -> Vec<String> {
        self.warnings.extend(diagnoses.iter().map(Diagnosis::to_string));
        diagnoses.iter().map(|diagnosis| format!("warning: {diagnosis}")).collect()
    }
}

/// The supervisor's subscriptions to the topics that are checked.
pub(crate) struct InputTopics {
    imu: Subscriber<ImuSample>,
    mag: Subscriber<MagSample>,
    fields: FieldQueue,
    /// Samples of the current poll. The buffer is reused.
    samples: Vec<ImuSample>,
    buffer: usize,
}

impl InputTopics {
    /// Subscribes to the topics. Returns `None` if the samples come from another host, which checks
    /// them itself.
    pub(crate) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Option<Self>, BusError> {
        if config.launch.tick_source() == TickSource::Gateway {
            return Ok(None);
        }
        let buffer = config.buffer_ticks();
        let (imu, mag) = (bus.subscriber(buffer)?, bus.subscriber(buffer)?);
        Ok(Some(Self { imu, mag, fields: FieldQueue::default(), samples: Vec::new(), buffer }))
    }

    /// Checks the messages received and returns new warnings to announce.
    pub(crate) fn poll(&mut self, checker: &mut InputChecker) -> Vec<String> {
        let Self { imu, mag, fields, samples, buffer } = self;
        samples.clear();
        // A magnetic field is published before the sample of its tick, so the fields of these
        // samples have arrived.
        let _ = imu.drain(*buffer, |sample| samples.push(sample));
        let _ = mag.drain(*buffer, |field| fields.push(field));
        let mut lines = Vec::new();
        for sample in samples {
            lines.extend(checker.check(sample, fields.take(sample.header.tick).as_ref()));
        }
        lines
    }
}
