//! A calibration of the running system's sensors: how far what came suffices, and what is found.
//!
//! Input: the sensors' own readings, and who asks for what. Output: what pages are told. Time: the observer's clock, for how often it is told
//! and when it is given up. Memory: that of a calibrator, which is bounded. Failure: what does not suffice is told as missing.

use std::time::{Duration, Instant};

use calibrate::{Calibrator, Kind, Known};
use graph::Topic;
use observe::readings;
use wire::v1::{self, Vector3};

/// Between two words of the coverage.
const REPORT_INTERVAL: Duration = Duration::from_millis(200);
/// Between two trials whether what there is suffices.
const SOLVE_INTERVAL: Duration = Duration::from_secs(2);
/// One that finds nothing for so long is given up.
const CALIBRATION_TIMEOUT: Duration = Duration::from_secs(600);

/// What is asked for, and what a system knows of its sensors.
#[derive(Debug, Clone)]
pub struct CalibrationRequest {
    /// What is calibrated.
    pub kind: Kind,
    /// What is known before.
    pub prior: Known,
    /// Where the readings are.
    pub topic: Topic,
}

/// A calibration that is under way.
#[derive(Debug)]
pub(crate) struct Calibration {
    kind: Kind,
    topic: Topic,
    calibrator: Calibrator,
    started: Instant,
    last_report: Option<Instant>,
    last_attempt: Option<Instant>,
}

impl Calibration {
    pub(crate) fn new(request: CalibrationRequest) -> Self {
        let calibrator = Calibrator::new(request.kind, &request.prior);
        Self { kind: request.kind, topic: request.topic, calibrator, started: Instant::now(), last_report: None, last_attempt: None }
    }

    /// Takes a message of a topic.
    pub(crate) fn push(&mut self, topic: Topic, bytes: &[u8]) {
        if topic == self.topic {
            readings::sample(topic, bytes).iter().for_each(|sample| self.calibrator.take(sample));
        }
    }

    /// It has found nothing for so long that it is given up.
    pub(crate) fn is_expired(&self) -> bool {
        self.started.elapsed() > CALIBRATION_TIMEOUT
    }

    /// What pages are to be told, now and then.
    pub(crate) fn progress(&mut self) -> Option<v1::Calibration> {
        if self.last_report.is_some_and(|told| told.elapsed() < REPORT_INTERVAL) {
            return None;
        }
        self.last_report = Some(Instant::now());
        let coverage = self.calibrator.coverage();
        let mut progress = v1::Calibration {
            what: Kind::NAMES.iter().find(|(_, kind)| *kind == self.kind).map_or("", |(name, _)| name).into(),
            share: coverage.share,
            found: coverage.found,
            missing: coverage.missing,
            parts: self.calibrator.parts().map_or(Vec::new(), Vec::from),
            direction: self.calibrator.direction().map(|at| Vector3 { x: at.x, y: at.y, z: at.z }),
            report: String::new(),
        };
        if coverage.share >= 1.0 && self.last_attempt.is_none_or(|tried| tried.elapsed() >= SOLVE_INTERVAL) {
            self.last_attempt = Some(Instant::now());
            match self.calibrator.finish() {
                Ok(report) => progress.report = report.to_string(),
                Err(error) => progress.missing = error.missing,
            }
        }
        Some(progress)
    }
}
