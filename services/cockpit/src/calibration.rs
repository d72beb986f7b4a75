//! Calibration of the running system's sensors, controlled from the page.
//!
//! Input: sensor readings and requests of viewers.
//! Output: progress reports for the page, the last one with the result.
//! Time: the local monotonic clock, for the report interval and the timeout.
//! Memory: that of a [`Calibrator`], which is bounded.
//! Failure: insufficient data is reported as missing.

use std::time::{Duration, Instant};

use calibrate::{Calibrator, Kind, Prior};
use graph::Topic;
use observe::readings::ReadingsTopic;
use wire::v1::{self, Vector3};

/// Interval between progress reports.
const REPORT_INTERVAL: Duration = Duration::from_millis(200);
/// Interval between attempts to compute the result.
const SOLVE_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum duration of a calibration.
const CALIBRATION_TIMEOUT: Duration = Duration::from_secs(600);

/// Request for a calibration, with the system's prior knowledge of its sensors.
#[derive(Debug, Clone)]
pub struct CalibrationRequest {
    /// Kind of calibration.
    pub kind: Kind,
    /// Local gravity and magnetic field, and existing calibrations of the sensors.
    pub prior: Prior,
    /// Topic with the sensor readings.
    pub topic: ReadingsTopic,
}

/// Calibration in progress.
#[derive(Debug)]
pub(crate) struct Calibration {
    kind: Kind,
    topic: ReadingsTopic,
    calibrator: Calibrator,
    started: Instant,
    last_report: Option<Instant>,
    last_attempt: Option<Instant>,
}

impl Calibration {
    pub(crate) fn new(request: CalibrationRequest) -> Self {
        let calibrator = Calibrator::new(request.kind, &request.prior);
        Self {
            kind: request.kind,
            topic: request.topic,
            calibrator,
            started: Instant::now(),
            last_report: None,
            last_attempt: None,
        }
    }

    /// Adds a message of `topic`. It is ignored unless `topic` carries the sensor readings.
    pub(crate) fn push(&mut self, topic: Topic, bytes: &[u8]) {
        if topic == self.topic.topic() {
            self.topic.decode(bytes).iter().for_each(|sample| self.calibrator.push(sample));
        }
    }

    /// Returns `true` if the calibration has exceeded [`CALIBRATION_TIMEOUT`].
    pub(crate) fn is_expired(&self) -> bool {
        self.started.elapsed() > CALIBRATION_TIMEOUT
    }

    /// Returns a progress report if at least [`REPORT_INTERVAL`] has passed since the last one.
    ///
    /// Once the calibration has a result, the field `report` of the progress report describes it.
    /// The second returned value is then the result as launch-file sections.
    pub(crate) fn progress(&mut self) -> Option<(v1::Calibration, Option<String>)> {
        if self.last_report.is_some_and(|last| last.elapsed() < REPORT_INTERVAL) {
            return None;
        }
        self.last_report = Some(Instant::now());
        let coverage = self.calibrator.coverage();
        let mut progress = v1::Calibration {
            what: Kind::NAMES.iter().find(|(_, kind)| *kind == self.kind).map_or("", |(name, _)| name).into(),
            share: coverage.share,
            found: coverage.summary,
            missing: coverage.missing,
            parts: self.calibrator.covered_sectors().map_or(Vec::new(), Vec::from),
            direction: self.calibrator.direction().map(|at| Vector3 { x: at.x, y: at.y, z: at.z }),
            report: String::new(),
        };
        if coverage.share >= 1.0 && self.last_attempt.is_none_or(|attempt| attempt.elapsed() >= SOLVE_INTERVAL) {
            self.last_attempt = Some(Instant::now());
            match self.calibrator.finish() {
                Ok(report) => {
                    progress.report = report.to_string();
                    return Some((progress, Some(report.block)));
                }
                Err(error) => progress.missing = error.missing,
            }
        }
        Some((progress, None))
    }
}
