//! What is said of the input while it is fused: the judge beside the path.
//!
//! Input: samples as ingest gives them. Output: warnings. Time: the samples' own. Failure: none; what cannot be read is not judged, and nobody
//! waits for it.

use bus::{Bus, BusError, Subscriber};
use judge::{Fields, Finding, Judge};
use launch::Service;
use messages::{ImuSample, MagSample};
use runtime::ServiceConfig;

/// The judge, and what it has said.
#[derive(Debug, Default)]
pub(crate) struct InputJudge {
    judge: Judge,
    warnings: Vec<String>,
}

impl InputJudge {
    /// Takes a sample, with the field where one came with it; gives lines for people.
    pub(crate) fn take(&mut self, imu: &ImuSample, mag: Option<&MagSample>) -> Vec<String> {
        let found = self.judge.take(imu, mag);
        self.told(&found)
    }

    /// What is found at the end and was not told before.
    pub(crate) fn finish(&mut self) -> Vec<String> {
        let found = self.judge.finish();
        self.told(&found)
    }

    /// It has said all that it will.
    pub(crate) fn is_ended(&self) -> bool {
        self.judge.is_ended()
    }

    /// Everything that was said.
    pub(crate) fn into_warnings(self) -> Vec<String> {
        self.warnings
    }

    fn told(&mut self, found: &[Finding]) -> Vec<String> {
        self.warnings.extend(found.iter().map(Finding::to_string));
        found.iter().map(|finding| format!("warning: {finding}")).collect()
    }
}

/// The topics that are judged, as the supervisor reads them.
pub(crate) struct InputTopics {
    imu: Subscriber<ImuSample>,
    mag: Subscriber<MagSample>,
    fields: Fields,
    buffer: usize,
}

impl InputTopics {
    /// None where the samples come from another host, which judges them itself.
    pub(crate) fn open(bus: &Bus, config: &ServiceConfig) -> Result<Option<Self>, BusError> {
        if config.launch.origin() != Service::Ingest {
            return Ok(None);
        }
        let buffer = config.buffer_ticks();
        let (imu, mag) = (bus.subscriber(buffer)?, bus.subscriber(buffer)?);
        Ok(Some(Self { imu, mag, fields: Fields::default(), buffer }))
    }

    /// Hands over what has come; gives lines for people.
    pub(crate) fn look(&mut self, judge: &mut InputJudge) -> Vec<String> {
        let Self { imu, mag, fields, buffer } = self;
        let mut samples = Vec::new();
        // A field is published before its sample, so those of these samples are there.
        let _ = imu.drain(*buffer, |sample| samples.push(sample));
        let _ = mag.drain(*buffer, |field| fields.push(field));
        let mut lines = Vec::new();
        for sample in samples {
            lines.extend(judge.take(&sample, fields.of(sample.header.tick).as_ref()));
        }
        lines
    }
}
