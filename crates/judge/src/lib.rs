//! Plausibility check of sensor input: units, signs, axes and timestamps.
//!
//! Input: samples after calibration and mounting, as they are about to be fused.
//!
//! Output: diagnoses with figures and remedies, each reported once. Samples are never changed.
//!
//! Time: that of the samples.
//!
//! Failure: samples that are not finite are skipped. Memory is bounded.
//!
//! | module | contents |
//! | --- | --- |
//! | [`diagnosis`] | diagnoses and their remedies |
//! | `field_queue` | magnetometer samples waiting for the IMU sample of their tick |
//! | `magnitude` | units, from the medians of force, magnetic field and sample interval |
//! | `rate_unit` | unit of the rates, from rotation that the force does not show |
//! | `axes_vs_gravity` | axes and unit of the gyro, from the rotation of gravity |
//! | `orientation` | direction of gravity |
//! | `axis_faults` | stuck and clipped axes |
#![forbid(unsafe_code)]

mod axes_vs_gravity;
mod axis_faults;
pub mod diagnosis;
mod field_queue;
mod magnitude;
mod orientation;
mod rate_unit;

use messages::{Flags, ImuSample, MagSample};

use axes_vs_gravity::GyroAxesCheck;
use axis_faults::{AxisMonitor, FieldMonitor};
pub use diagnosis::{Diagnosis, InputIssue, PossibleCause};
pub use field_queue::FieldQueue;
use magnitude::MagnitudeCheck;
use orientation::OrientationCheck;
use rate_unit::RateUnitCheck;

/// Interval between two evaluations on the clock of the samples, s. It equals the length of the
/// longest window.
const EVALUATION_INTERVAL_S: f64 = 2.0;
/// Minimum number of samples for an evaluation, both in total and since the previous evaluation.
/// The 10 % quantile needs that many.
const MIN_EVALUATION_SAMPLES: u64 = 100;
/// Minimum number of samples before the first evaluation. If the times of the samples are in a
/// wrong unit, a few samples may appear to span the evaluation interval.
const MIN_INITIAL_SAMPLES: u64 = 200;
/// Duration of usable motion after which the check ends, s. It is thirty windows, ten times as many
/// as a diagnosis needs.
const SUFFICIENT_MOTION_S: f64 = 60.0;
/// Time after which the check ends even without motion, s.
const MAX_SPAN_S: f64 = 120.0;
/// Number of samples after which the check ends, regardless of their timestamps: one minute at 8
/// kHz.
const MAX_SAMPLES: u64 = 500_000;
/// Largest magnitude of a vector component for its sample to be checked. Squares of such components
/// and products of these squares are finite.
const SQUARE_SAFE_MAX: f64 = 1e9;
/// Minimum number of clipped rates for a diagnosis. Throwing the body causes only a few.
const MIN_CLIPPED_RATES: u64 = 50;
/// Minimum number of invalid rates for a diagnosis. A spike on the wire causes only one.
const MIN_IMPLAUSIBLE_RATES: u64 = 5;
/// Minimum number of invalid forces for a diagnosis. A spike on the wire causes only one.
const MIN_IMPLAUSIBLE_FORCES: u64 = 5;
/// Minimum number of timestamp faults for a diagnosis. A start or restart of a device causes only
/// one.
const MIN_TIMESTAMP_FAULTS: u64 = 3;
/// Lower bound of gyro measuring ranges, rad/s. The smallest usual range is 125 °/s.
const MIN_RATE_RANGE_RAD_S: f64 = 2.0;
/// Lower bound of accelerometer measuring ranges, m/s². The smallest usual range is 2 g. The bound
/// is lower to allow for scale errors.
const MIN_FORCE_RANGE_M_S2: f64 = 15.0;

/// Plausibility check of one stream of samples.
#[derive(Debug, Clone)]
pub struct InputCheck {
    magnitude: MagnitudeCheck,
    gyro_axes: GyroAxesCheck,
    rate_unit: RateUnitCheck,
    orientation: OrientationCheck,
    rate_axes: AxisMonitor,
    force_axes: AxisMonitor,
    field_axes: AxisMonitor,
    new_fields: FieldMonitor,
    samples: u64,
    next_tick: u64,
    first_ns: Option<i64>,
    span_s: f64,
    last_evaluation: (f64, u64),
    clipped_rates: u64,
    implausible_rates: u64,
    implausible_forces: u64,
    rejected: u64,
    clock_leaps: u64,
    reported: Vec<InputIssue>,
    finished: bool,
}

impl Default for InputCheck {
    fn default() -> Self {
        Self {
            magnitude: MagnitudeCheck::default(),
            gyro_axes: GyroAxesCheck::default(),
            rate_unit: RateUnitCheck::default(),
            orientation: OrientationCheck::default(),
            rate_axes: AxisMonitor::new("rate", "gyro", MIN_RATE_RANGE_RAD_S),
            force_axes: AxisMonitor::new("force", "accelerometer", MIN_FORCE_RANGE_M_S2),
            // Iron in the vehicle can multiply the magnetic field, so its range is not checked.
            field_axes: AxisMonitor::new("field", "magnetometer", f64::INFINITY),
            new_fields: FieldMonitor::default(),
            samples: 0,
            next_tick: 0,
            first_ns: None,
            span_s: 0.0,
            last_evaluation: (0.0, 0),
            clipped_rates: 0,
            implausible_rates: 0,
            implausible_forces: 0,
            rejected: 0,
            clock_leaps: 0,
            reported: Vec::new(),
            finished: false,
        }
    }
}

impl InputCheck {
    /// Adds a sample and returns the new diagnoses, usually none.
    ///
    /// `mag` is the magnetometer sample of the same tick, if present.
    pub fn update(&mut self, imu: &ImuSample, mag: Option<&MagSample>) -> Vec<Diagnosis> {
        let tick = imu.header.tick;
        // A restarted source resends samples that have already been checked.
        if self.finished || tick < self.next_tick || imu.header.flags.any(Flags::FAULT_INJECTED) {
            return Vec::new();
        }
        if tick > self.next_tick {
            self.interrupt();
        }
        self.next_tick = tick + 1;
        self.record(imu, mag);
        let is_due = self.samples >= MIN_INITIAL_SAMPLES
            && self.span_s - self.last_evaluation.0 >= EVALUATION_INTERVAL_S
            && self.samples - self.last_evaluation.1 >= MIN_EVALUATION_SAMPLES;
        let is_complete = self.samples >= MIN_INITIAL_SAMPLES && self.span_s >= MAX_SPAN_S
            || self.gyro_axes.motion_s() >= SUFFICIENT_MOTION_S
            || self.samples >= MAX_SAMPLES;
        if is_complete {
            return self.finish();
        }
        if is_due { self.evaluate() } else { Vec::new() }
    }

    /// Returns `true` if the check has ended and will report nothing further.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Ends the check and returns the remaining diagnoses.
    pub fn finish(&mut self) -> Vec<Diagnosis> {
        if self.finished {
            return Vec::new();
        }
        self.finished = true;
        self.evaluate()
    }

    fn record(&mut self, imu: &ImuSample, mag: Option<&MagSample>) {
        let flags = imu.header.flags;
        self.samples += 1;
        self.rejected += u64::from(flags.any(Flags::REFUSED_BEFORE));
        self.clipped_rates += u64::from(flags.any(Flags::RATE_CLIPPED));
        self.implausible_rates += u64::from(flags.any(Flags::RATE_INVALID));
        self.clock_leaps += u64::from(flags.any(Flags::CLOCK_LEAP));
        let first_ns = *self.first_ns.get_or_insert(imu.header.t_end_ns);
        self.span_s = imu.header.t_end_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let dt_s = imu.header.t_end_ns.saturating_sub(imu.header.t_start_ns) as f64 * 1e-9;
        if self.samples > 1 {
            self.magnitude.push_interval(dt_s);
        }
        self.new_fields.push(mag.is_some());
        match mag {
            Some(mag) if is_in_range(mag.field_ut) => {
                self.magnitude.push_field(mag.field_ut);
                self.field_axes.push(mag.field_ut);
                self.orientation.push_field(mag.field_ut);
            }
            Some(_) => {}
            None => self.magnitude.push_missing_field(flags.any(Flags::FIELD_INVALID)),
        }
        if !is_in_range(imu.rate_rad_s) || !is_in_range(imu.force_m_s2) {
            return self.interrupt();
        }
        if !flags.any(Flags::RATE_INVALID) {
            self.rate_axes.push(imu.rate_rad_s);
        }
        if flags.any(Flags::FORCE_INVALID) {
            self.implausible_forces += 1;
            return self.interrupt();
        }
        self.force_axes.push(imu.force_m_s2);
        self.magnitude.push_force(imu.force_m_s2);
        if flags.any(Flags::RATE_INVALID | Flags::GAP | Flags::CLOCK_LEAP | Flags::FORCE_STUCK) {
            return self.interrupt();
        }
        self.orientation.push(dt_s, imu.rate_rad_s, imu.force_m_s2);
        self.gyro_axes.push(dt_s, imu.rate_rad_s, imu.force_m_s2);
        self.rate_unit.push(dt_s, imu.rate_rad_s, imu.force_m_s2);
    }

    /// Discards open windows after a discontinuity.
    fn interrupt(&mut self) {
        self.gyro_axes.interrupt();
        self.rate_unit.interrupt();
    }

    fn evaluate(&mut self) -> Vec<Diagnosis> {
        self.last_evaluation = (self.span_s, self.samples);
        if self.samples < MIN_EVALUATION_SAMPLES {
            return Vec::new();
        }
        let mut found = Vec::new();
        found.extend(self.magnitude.diagnose_interval(self.clock_leaps, self.samples));
        let time_unit_is_wrong = !found.is_empty();
        if !time_unit_is_wrong && self.rejected + self.clock_leaps >= MIN_TIMESTAMP_FAULTS {
            found.push(diagnosis::timestamps(self.rejected, self.clock_leaps, self.samples));
        }
        let has_force_unit = |found: &[Diagnosis]| found.iter().any(|found| found.issue == InputIssue::ForceUnit);
        found.extend(self.magnitude.diagnose_force(self.span_s));
        if self.implausible_forces >= MIN_IMPLAUSIBLE_FORCES && !has_force_unit(&found) {
            found.push(diagnosis::rejected_forces(self.implausible_forces));
        }
        let has_gravity = !found.iter().any(|diagnosis| diagnosis.issue == InputIssue::GravityRemoved);
        found.extend(self.magnitude.diagnose_field());
        if !time_unit_is_wrong && has_gravity {
            found.extend(self.gyro_axes.diagnose());
            if found.iter().all(|diagnosis| !diagnosis.issue.is_gyro_mismatch()) {
                found.extend(self.rate_unit.diagnose());
            }
            if found.iter().all(|diagnosis| !diagnosis.issue.is_gyro_mismatch())
                && self.clipped_rates >= MIN_CLIPPED_RATES
                && self.implausible_rates >= MIN_IMPLAUSIBLE_RATES
            {
                found.push(diagnosis::rates_out_of_range(self.clipped_rates, self.implausible_rates));
            }
            found.extend(self.orientation.diagnose());
        }
        let rate_unit_is_wrong = found.iter().any(|diagnosis| diagnosis.issue == InputIssue::RateUnit);
        let has_rotated = self.gyro_axes.has_enough_windows();
        found.extend(self.rate_axes.diagnose(has_rotated, rate_unit_is_wrong));
        found.extend(self.force_axes.diagnose(has_rotated, false));
        found.extend(self.field_axes.diagnose(has_rotated, true).or_else(|| self.new_fields.diagnose(has_rotated)));
        found.retain(|diagnosis| !self.reported.contains(&diagnosis.issue));
        self.reported.extend(found.iter().map(|diagnosis| diagnosis.issue));
        found
    }
}

fn is_in_range(vector: [f64; 3]) -> bool {
    vector.iter().all(|x| x.abs() < SQUARE_SAFE_MAX)
}

/// Counter of timestamp faults in readings that have not been conditioned.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TimestampCheck {
    /// Number of timestamps equal to the previous one.
    pub repeated: u64,
    /// Number of timestamps earlier than the previous one.
    pub out_of_order: u64,
    last_ns: Option<i64>,
}

impl TimestampCheck {
    /// Adds the timestamp of a reading, ns.
    pub fn push(&mut self, t_ns: i64) {
        if let Some(last_ns) = self.last_ns.replace(t_ns) {
            self.repeated += u64::from(t_ns == last_ns);
            self.out_of_order += u64::from(t_ns < last_ns);
        }
    }
}
