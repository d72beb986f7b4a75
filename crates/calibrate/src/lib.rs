//! Sensor calibration: estimates the errors of a sensor unit from its raw readings.
//!
//! Input: raw readings of one sensor unit in time order.
//!
//! Output: the errors with standard deviations, the residuals before and after calibration, the
//! coverage, and a section for `launch.toml`; or a [`Rejection`] that lists what is missing.
//!
//! Time: timestamps of the readings only.
//!
//! Failure: insufficient coverage is rejected with instructions. Readings that are not finite or
//! not in time order are skipped and counted.
//!
//! | module | content |
//! | --- | --- |
//! | [`gyro`] | bias, from rests |
//! | [`accel`] | bias, scale and misalignment, from rests in many positions or slow rotation |
//! | [`mag`] | hard and soft iron, from the magnetic field in all directions |
//! | [`mounting`] | orientation of the unit in the body, from a level and a nose-down pose |
//! | [`clock`] | delay of the magnetometer relative to the gyro, from back-and-forth turns |
//! | [`noise`] | Allan deviations and noise of gyro and accelerometer, from a long rest |
//! | `input` | kind, prior knowledge and readings |
//! | [`report`] | report, coverage and rejection |
//! | `rest` | detection of rests and uncertainty of their means |
//! | `motion` | mean specific force over windows in motion |
//! | `sphere` | coverage of directions |
//! | `ellipsoid` | model shared by accelerometer and magnetometer |
//! | `least_squares` | normal equations and covariances |
//! | `history` | gyro attitude at any time of the recording |
#![forbid(unsafe_code)]

pub mod accel;
pub mod clock;
mod ellipsoid;
pub mod gyro;
mod history;
mod input;
mod least_squares;
pub mod mag;
mod motion;
pub mod mounting;
pub mod noise;
pub mod report;
mod rest;
mod sphere;

use attitude::Vector3;

use input::Intake;
pub use input::{Kind, Prior, Sample};
pub use report::{Coverage, Rejection, Report};
pub use sphere::SECTORS;

/// Collects readings until they suffice for a calibration.
#[derive(Debug, Clone)]
pub struct Calibrator {
    inner: SensorCalibrator,
    intake: Intake,
}

#[derive(Debug, Clone)]
enum SensorCalibrator {
    Gyro(gyro::GyroCalibrator),
    Accel(Box<accel::AccelCalibrator>),
    Mag(mag::MagCalibrator),
    Mounting(mounting::MountingCalibrator),
    Clock(clock::ClockCalibrator),
}

impl Calibrator {
    /// Creates a calibrator that has no readings.
    pub fn new(kind: Kind, prior: &Prior) -> Self {
        let inner = match kind {
            Kind::Gyro => SensorCalibrator::Gyro(gyro::GyroCalibrator::default()),
            Kind::Accel => SensorCalibrator::Accel(Box::new(accel::AccelCalibrator::new(prior))),
            Kind::Mag => SensorCalibrator::Mag(mag::MagCalibrator::new(prior)),
            Kind::Mounting => SensorCalibrator::Mounting(mounting::MountingCalibrator::new(prior)),
            Kind::Clock => SensorCalibrator::Clock(clock::ClockCalibrator::new(prior)),
        };
        Self { inner, intake: Intake::default() }
    }

    /// Adds a reading. Skips it if its rate or force is not finite or its time does not increase.
    pub fn push(&mut self, sample: &Sample) {
        let Some(sample) = self.intake.accept(sample) else { return };
        match &mut self.inner {
            SensorCalibrator::Gyro(inner) => inner.push(&sample),
            SensorCalibrator::Accel(inner) => inner.push(&sample),
            SensorCalibrator::Mag(inner) => inner.push(&sample),
            SensorCalibrator::Mounting(inner) => inner.push(&sample),
            SensorCalibrator::Clock(inner) => inner.push(&sample),
        }
    }

    /// Returns the coverage achieved by the readings so far.
    pub fn coverage(&self) -> Coverage {
        match &self.inner {
            SensorCalibrator::Gyro(inner) => inner.coverage(),
            SensorCalibrator::Accel(inner) => inner.coverage(),
            SensorCalibrator::Mag(inner) => inner.coverage(),
            SensorCalibrator::Mounting(inner) => inner.coverage(),
            SensorCalibrator::Clock(inner) => inner.coverage(),
        }
    }

    /// Returns, for each of the [`SECTORS`] in sensor axes, `true` if it is covered.
    ///
    /// The result is `None` if the calibration does not depend on directions.
    pub fn covered_sectors(&self) -> Option<[bool; SECTORS]> {
        match &self.inner {
            SensorCalibrator::Accel(inner) => Some(inner.covered_sectors()),
            SensorCalibrator::Mag(inner) => Some(inner.covered_sectors()),
            SensorCalibrator::Gyro(_) | SensorCalibrator::Mounting(_) | SensorCalibrator::Clock(_) => None,
        }
    }

    /// Returns the most recent specific force (m/s²) or magnetic field (µT) in sensor axes.
    ///
    /// The result is `None` if the calibration does not depend on directions or there is no
    /// reading.
    pub fn direction(&self) -> Option<Vector3<f64>> {
        match &self.inner {
            SensorCalibrator::Accel(inner) => inner.direction(),
            SensorCalibrator::Mag(inner) => inner.direction(),
            SensorCalibrator::Gyro(_) | SensorCalibrator::Mounting(_) | SensorCalibrator::Clock(_) => None,
        }
    }

    /// Computes the calibration.
    ///
    /// # Errors
    ///
    /// Returns a [`Rejection`] that lists what is missing if the coverage is below 1 or the result
    /// is too uncertain.
    pub fn finish(&self) -> Result<Report, Rejection> {
        let mut report = match &self.inner {
            SensorCalibrator::Gyro(inner) => inner.finish(),
            SensorCalibrator::Accel(inner) => inner.finish(),
            SensorCalibrator::Mag(inner) => inner.finish(),
            SensorCalibrator::Mounting(inner) => inner.finish(),
            SensorCalibrator::Clock(inner) => inner.finish(),
        }?;
        report.notes.extend(self.intake.note());
        Ok(report)
    }
}
