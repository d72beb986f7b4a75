//! Converts readings to checked samples: each accepted reading becomes a tick.
//!
//! Input: readings as reported by the sensors. The faults that the launch file injects are applied
//! first; the checks are those of [`attitude::conditioner`].
//!
//! Output: samples as messages.
//!
//! Time: the timestamps of the readings.
//!
//! Failure: a repeated or outdated reading is rejected and counted.

use attitude::{
    Matrix3, Quaternion,
    calibration::{CalibrationError, Mounting},
    conditioner::{self, SensorModel},
    flags::Flags,
    gnss::ReceiverFix,
};
use launch::{GyroSamples, Ingest};
use messages::{GnssFix, Header, ImuSample, MagSample};

use crate::{
    fault_injection::FaultInjector,
    source::{Reading, Truth},
};

/// Sample of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Rate and force.
    pub imu: ImuSample,
    /// Magnetic field, if the reading has a new valid one.
    pub mag: Option<MagSample>,
    /// Fix, if one arrived and is valid.
    pub gnss: Option<GnssFix>,
    /// True attitude of the body axes, derived from the source's attitude of the sensor axes;
    /// `None` if the source does not provide the attitude.
    pub reference: Option<Truth>,
}

/// Conditioner that checks the readings of a source and numbers the samples.
#[derive(Debug, Clone)]
pub struct Conditioner {
    fault_injector: FaultInjector,
    /// `true` if a fault was injected since the last sample.
    has_injected_fault: bool,
    checks: conditioner::Conditioner,
}

fn truth_to_body(mounting: &Mounting, truth: Truth) -> Truth {
    let [w, x, y, z] = truth.quaternion;
    let body = mounting.attitude(Quaternion::new(w, x, y, z));
    Truth { quaternion: [body.w, body.i, body.j, body.k], ..truth }
}

fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}

impl Conditioner {
    /// Creates a conditioner for sensors that sample at `rate_hz`. Limits, calibration and mounting
    /// are taken from `ingest`.
    ///
    /// # Errors
    ///
    /// Returns an error if a calibration or the mounting is invalid.
    pub fn new(ingest: &Ingest, rate_hz: f64, kind: GyroSamples) -> Result<Self, CalibrationError> {
        let sensors = SensorModel {
            limits: ingest.limits,
            rate_hz,
            rate_kind: kind.rate_kind(),
            mounting: Mounting::from_matrix(matrix(ingest.mounting))?,
            gyro: ingest.calibration.gyro.to_calibration()?,
            accel: ingest.calibration.accel.to_calibration()?,
            mag: ingest.calibration.mag.to_calibration()?,
        };
        let checks = conditioner::Conditioner::new(&sensors);
        Ok(Self { fault_injector: FaultInjector::new(&ingest.faults), has_injected_fault: false, checks })
    }

    /// Returns the sample of a reading, or `None` if it is rejected or dropped by an injected
    /// fault.
    pub fn condition(&mut self, reading: &Reading) -> Option<Sample> {
        let (reading, is_active) = self.fault_injector.inject(&reading.without_negative_zero())?;
        self.has_injected_fault |= is_active;
        let sample = self.checks.condition(&reading.sensors())?;
        let injected = Flags::FAULT_INJECTED.when(std::mem::take(&mut self.has_injected_fault));
        let conditioner::Sample { tick, t_start_ns, t_end_ns, flags, rate_rad_s, force_m_s2, field_ut, fix } = sample;
        let header = Header { tick, t_start_ns, t_end_ns, flags: flags | injected, ..bytemuck::Zeroable::zeroed() };
        Some(Sample {
            imu: ImuSample { header, rate_rad_s, force_m_s2 },
            mag: field_ut.map(|field_ut| MagSample { header, field_ut }),
            gnss: fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| GnssFix {
                header,
                velocity_m_s: fix.velocity_m_s.into(),
                velocity_sd_m_s: fix.sd_m_s.unwrap_or(f64::NAN),
                age_s: fix.age_s.unwrap_or(f64::NAN),
                latitude_rad: fix.latitude_rad.unwrap_or(f64::NAN),
                longitude_rad: longitude_rad.unwrap_or(f64::NAN),
                altitude_m: altitude_m.unwrap_or(f64::NAN),
            }),
            reference: reading.reference.map(|truth| truth_to_body(self.checks.mounting(), truth)),
        })
    }

    /// Resumes at `tick` with the [`offset_ns`](Self::offset_ns) of an earlier conditioner. The
    /// next sample follows a gap.
    pub fn resume_at(&mut self, tick: u64, offset_ns: i64) {
        self.checks.resume_at(tick, offset_ns);
    }

    /// Returns the sample time minus the sensor time, ns.
    pub fn offset_ns(&self) -> i64 {
        self.checks.offset_ns()
    }

    /// Returns the number of ticks so far.
    pub fn ticks(&self) -> u64 {
        self.checks.ticks()
    }

    /// Returns the number of rejected readings so far.
    pub fn rejected(&self) -> u64 {
        self.checks.rejected()
    }
}
