//! Converts readings to checked samples: each accepted reading becomes a tick.
//!
//! Input: readings as reported by the sensors. They are checked in sensor axes. If the calibration
//! converts their unit, for example from raw counts, the limits apply after the calibration. The
//! mounting is applied last.
//!
//! Output: samples with finite values, increasing time and contiguous ticks. Flags mark problems.
//!
//! Time: the timestamps of the readings.
//!
//! Failure: a repeated or outdated reading is rejected and counted.
//!
//! | reading | result |
//! | --- | --- |
//! | a rate or force that is not finite, or far beyond the range | the last valid value, flagged; rate 0 after `gap_s` |
//! | a magnetic field that is not finite or at the end of the range; an implausible fix | omitted, flagged |
//! | a magnetic field equal to the previous one | no new magnetic field sample |
//! | a value at the end of the range | unchanged, flagged |
//! | \|f\| near zero | unchanged; flagged and ignored by accel |
//! | the same vector for `stuck_s` | unchanged, flagged; a stuck force is ignored while the rate still varies |
//! | the timestamp and values of the previous reading | rejected |
//! | the timestamp of the previous reading with other values | a sample one typical interval later, flagged |
//! | a later timestamp that is not after the sample time, which repeated timestamps have advanced | a sample half a typical interval later, flagged, until the sample time agrees with the timestamps |
//! | a timestamp before the previous one | rejected; if the next timestamp is later than the rejected one, the clock was set back, and the sample time continues, flagged |
//! | a timestamp more than `gap_s` after the previous one | a sample after a gap, flagged; if the gap exceeds 1 s, the level is initialised again |
//! | a timestamp more than 10 s after the previous one | counts as a leap of the clock; the sample time continues, flagged |

mod channel;
mod reading;
mod transform;

pub use reading::{Reading, Sample};

use crate::{
    calibration::{Calibration, Mounting},
    flags::Flags,
    gnss::ReceiverFix,
    gyro::RateKind,
    parameters::settings,
    state_words::StateWords,
};
use {
    channel::{FieldChannel, VectorChannel, check_fix},
    transform::SensorTransform,
};

/// Longest step between timestamps that counts as a gap, ns. A longer step is a leap of the clock.
const MAX_GAP_NS: i64 = 10_000_000_000;
/// Maximum magnitude of the first timestamp, ns (285 years), so that time can run for years without
/// overflow.
const MAX_START_NS: i64 = 9_000_000_000_000_000_000;
/// Maximum number of consecutive backward timestamps that are rejected. After that, the sensor's
/// clock is considered to have been set back, and the sample time continues.
const MAX_BACKWARD_STAMPS: i64 = 10;

settings! {
    /// Limits beyond which samples are flagged.
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
    pub struct Limits {
        /// Rate at and beyond which a sample is flagged as clipped.
        rate_max_deg_s: 2000.0 in 1.0 .. 100_000.0, "°/s";
        /// Specific force at and beyond which a sample is flagged as clipped.
        force_max_g: 16.0 in 0.1 .. 10_000.0, "g";
        /// Longest interval between samples that is not flagged as a gap.
        gap_s: 0.1 in 0.001 .. 10.0, "s";
        /// Time after which a sensor with constant output is flagged as stuck.
        stuck_s: 0.5 in 0.01 .. 60.0, "s";
        /// Component of the magnetic field at and beyond which the field sample is rejected.
        field_max_ut: 2000.0 in 1.0 .. 1e6, "µT";
    }
}

/// Properties of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorModel {
    /// Limits beyond which samples are flagged.
    pub limits: Limits,
    /// Nominal sampling rate, Hz. It must be above 0.
    ///
    /// The rate sets the interval of samples with unusable timestamps, but only until other
    /// timestamps show the true interval.
    pub rate_hz: f64,
    /// Meaning of a rate sample: the mean over its interval or the value at the end of it.
    pub rate_kind: RateKind,
    /// Orientation of the sensors in the body.
    pub mounting: Mounting,
    /// Calibration of the gyro.
    pub gyro: Calibration,
    /// Calibration of the accelerometer.
    pub accel: Calibration,
    /// Calibration of the magnetometer.
    pub mag: Calibration,
}

impl Default for SensorModel {
    /// Returns calibrated sensors in body axes, sampled at 100 Hz.
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            rate_hz: 100.0,
            rate_kind: RateKind::Mean,
            mounting: Mounting::default(),
            gyro: Calibration::default(),
            accel: Calibration::default(),
            mag: Calibration::default(),
        }
    }
}

/// Conditioner that checks the readings of a source and numbers the samples.
#[derive(Debug, Clone)]
pub struct Conditioner {
    rate: VectorChannel,
    force: VectorChannel,
    field: FieldChannel,
    /// Fix to pass on with the next sample, because its own reading was rejected.
    pending_fix: Option<ReceiverFix>,
    mounting: Mounting,
    transforms: BodyTransforms,
    gap_ns: i64,
    rate_kind_flag: Flags,
    tick: u64,
    /// Sample time minus sensor time, ns.
    offset_ns: i64,
    typical_interval_ns: i64,
    last: Option<LastSample>,
    /// Timestamp of the previous reading and number of consecutive rejected readings.
    ///
    /// `None` unless the previous reading was rejected as outdated.
    backward_run: Option<(i64, i64)>,
    rejected: u64,
    rejected_before: bool,
    /// `true` if the conditioner resumes from the state of an earlier conditioner.
    is_resumed: bool,
}

/// Transforms from sensor axes to body axes.
#[derive(Debug, Clone)]
struct BodyTransforms {
    gyro: SensorTransform,
    accel: SensorTransform,
    mag: SensorTransform,
}

/// Newest accepted reading, and the end of its sample.
#[derive(Debug, Clone, Copy, Default)]
struct LastSample {
    t_end_ns: i64,
    t_ns: i64,
    rate_rad_s: [f64; 3],
    force_m_s2: [f64; 3],
}

impl Conditioner {
    /// Creates a conditioner for the readings of `sensors`.
    pub fn new(sensors: &SensorModel) -> Self {
        let SensorModel { limits, rate_hz, rate_kind, mounting, gyro, accel, mag } = *sensors;
        let stuck_ns = (limits.stuck_s * 1e9) as i64;
        let gap_ns = (limits.gap_s * 1e9) as i64;
        Self {
            rate: VectorChannel {
                limit: limits.rate_max_deg_s.to_radians(),
                invalid: Flags::RATE_INVALID,
                clipped: Flags::RATE_CLIPPED,
                stuck: Flags::RATE_STUCK,
                stuck_ns,
                ..VectorChannel::default()
            },
            force: VectorChannel {
                limit: limits.force_max_g * crate::GRAVITY_M_S2,
                invalid: Flags::FORCE_INVALID,
                clipped: Flags::FORCE_CLIPPED,
                stuck: Flags::FORCE_STUCK,
                stuck_ns,
                ..VectorChannel::default()
            },
            field: FieldChannel::new(limits.field_max_ut),
            pending_fix: None,
            mounting,
            transforms: BodyTransforms {
                gyro: SensorTransform::new(gyro, mounting),
                accel: SensorTransform::new(accel, mounting),
                mag: SensorTransform::new(mag, mounting),
            },
            gap_ns,
            rate_kind_flag: Flags::RATE_INSTANT.when(rate_kind == RateKind::Instant),
            tick: 0,
            offset_ns: 0,
            typical_interval_ns: (1e9 / rate_hz) as i64,
            last: None,
            backward_run: None,
            rejected: 0,
            rejected_before: false,
            is_resumed: false,
        }
    }

    /// Returns the sample of a reading, or `None` if the reading is rejected.
    #[inline(always)]
    pub fn condition(&mut self, reading: &Reading) -> Option<Sample> {
        if reading.fix.is_some() {
            self.pending_fix = reading.fix;
        }
        let Some((t_start_ns, t_end_ns, time_flags)) = self.assign_interval(reading) else {
            self.rejected += 1;
            self.rejected_before = true;
            return None;
        };
        let dt_ns = t_end_ns - t_start_ns;
        let BodyTransforms { gyro, accel, mag } = &self.transforms;
        let (rate_rad_s, rate_flags) = self.rate.check(reading.rate_rad_s, gyro, dt_ns);
        let (force_m_s2, force_flags) = self.force.check(reading.force_m_s2, accel, dt_ns);
        let is_rate_lost = self.rate.invalid_ns > self.gap_ns;
        let rate_rad_s = if is_rate_lost { [0.0; 3] } else { gyro.in_body_axes(rate_rad_s) };
        let force_m_s2 = accel.in_body_axes(force_m_s2);
        let (field_ut, field_flags) = self.field.check(reading.field_ut, mag);
        let field_ut = field_ut.map(|field_ut| mag.in_body_axes(field_ut));
        let (fix, fix_flags) = if self.pending_fix.is_some() { self.take_fix() } else { (None, Flags::NONE) };
        let rejected = Flags::REFUSED_BEFORE.when(core::mem::take(&mut self.rejected_before));
        let value_flags = rate_flags | force_flags | field_flags | fix_flags;
        let flags = time_flags | value_flags | rejected | self.rate_kind_flag;
        let tick = self.tick;
        self.tick += 1;
        let Reading { t_ns, .. } = *reading;
        self.last = Some(LastSample { t_end_ns, t_ns, rate_rad_s: reading.rate_rad_s, force_m_s2: reading.force_m_s2 });
        Some(Sample { tick, t_start_ns, t_end_ns, flags, rate_rad_s, force_m_s2, field_ut, fix })
    }

    /// Returns the pending fix without implausible values.
    #[cold]
    fn take_fix(&mut self) -> (Option<ReceiverFix>, Flags) {
        check_fix(self.pending_fix.take())
    }

    /// Resumes at `tick` with the [`offset_ns`](Self::offset_ns) of an earlier conditioner. The
    /// next sample is flagged as following a gap.
    pub fn resume_at(&mut self, tick: u64, offset_ns: i64) {
        (self.tick, self.offset_ns, self.is_resumed) = (tick, offset_ns, true);
    }

    /// Returns the orientation of the sensors in the body.
    pub fn mounting(&self) -> &Mounting {
        &self.mounting
    }

    /// Returns the sample time minus the sensor time, ns.
    pub fn offset_ns(&self) -> i64 {
        self.offset_ns
    }

    /// Returns the number of ticks so far.
    pub fn ticks(&self) -> u64 {
        self.tick
    }

    /// Returns the number of rejected readings so far.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Returns the start, the end and the time flags of a reading's interval, or `None` if the
    /// reading is rejected.
    #[inline(always)]
    fn assign_interval(&mut self, reading: &Reading) -> Option<(i64, i64, Flags)> {
        let Some(last) = self.last else {
            if self.is_resumed {
                let t_ns = reading.t_ns.saturating_add(self.offset_ns);
                return Some((t_ns, t_ns, Flags::GAP));
            }
            let t_ns = reading.t_ns.clamp(-MAX_START_NS, MAX_START_NS);
            self.offset_ns = t_ns - reading.t_ns;
            return Some((t_ns, t_ns, Flags::CLOCK_LEAP.when(self.offset_ns != 0)));
        };
        let is_same_stamp = reading.t_ns == last.t_ns;
        if is_same_stamp && is_repeated(reading, &last) {
            return None;
        }
        let dt_ns = reading.t_ns.saturating_add(self.offset_ns).saturating_sub(last.t_end_ns);
        let mut catches_up = false;
        let (dt_ns, flags) = match dt_ns {
            1..=MAX_GAP_NS => (dt_ns, Flags::GAP.when(dt_ns > self.gap_ns)),
            // Repeated timestamps before this one advanced the sample time beyond the sensor time.
            ..=0 if reading.t_ns > last.t_ns && dt_ns >= -self.gap_ns => {
                self.typical_interval_ns = (self.typical_interval_ns + (dt_ns - self.typical_interval_ns) / 16).max(2);
                catches_up = true;
                (self.typical_interval_ns / 2, Flags::CLOCK_LEAP)
            }
            _ if dt_ns < 0 && !is_same_stamp => (self.interval_after_set_back(reading.t_ns)?, Flags::CLOCK_LEAP),
            _ => (self.typical_interval_ns, Flags::CLOCK_LEAP),
        };
        self.backward_run = None;
        if flags == Flags::NONE {
            self.typical_interval_ns += (dt_ns - self.typical_interval_ns) / 16;
        }
        let t_end_ns = last.t_end_ns.checked_add(dt_ns)?;
        if flags.any(Flags::CLOCK_LEAP) && !is_same_stamp && !catches_up {
            self.offset_ns = t_end_ns.saturating_sub(reading.t_ns);
        }
        Some((last.t_end_ns, t_end_ns, flags))
    }

    /// Returns the interval to use, ns, if the clock was certainly set back; otherwise `None`.
    ///
    /// A timestamp is outdated if it is earlier than that of the last accepted reading. The clock
    /// was certainly set back after two consecutive outdated timestamps in increasing order, or
    /// after [`MAX_BACKWARD_STAMPS`] outdated timestamps in any order.
    fn interval_after_set_back(&mut self, t_ns: i64) -> Option<i64> {
        match self.backward_run {
            Some((before_ns, count))
                if (1..=self.gap_ns).contains(&t_ns.saturating_sub(before_ns)) || count >= MAX_BACKWARD_STAMPS =>
            {
                Some(self.typical_interval_ns.saturating_mul(count + 1))
            }
            run => {
                self.backward_run = Some((t_ns, run.map_or(1, |(_, count)| count + 1)));
                None
            }
        }
    }
}

/// Returns `true` if the reading has the rate and force of the last one, bit for bit.
fn is_repeated(reading: &Reading, last: &LastSample) -> bool {
    let bits = |vector: [f64; 3]| vector.map(f64::to_bits);
    (bits(reading.rate_rad_s), bits(reading.force_m_s2)) == (bits(last.rate_rad_s), bits(last.force_m_s2))
}

/// Visits the state. The properties of the sensors are not part of it.
impl StateWords for Conditioner {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self {
            rate,
            force,
            field,
            pending_fix,
            mounting: _,
            transforms: _,
            gap_ns: _,
            rate_kind_flag: _,
            tick,
            offset_ns,
            typical_interval_ns,
            last,
            backward_run,
            rejected,
            rejected_before,
            is_resumed,
        } = self;
        rate.visit(visit);
        force.visit(visit);
        field.visit(visit);
        pending_fix.visit(visit);
        tick.visit(visit);
        offset_ns.visit(visit);
        typical_interval_ns.visit(visit);
        last.visit(visit);
        backward_run.visit(visit);
        rejected.visit(visit);
        rejected_before.visit(visit);
        is_resumed.visit(visit);
    }
}

impl StateWords for LastSample {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        let Self { t_end_ns, t_ns, rate_rad_s, force_m_s2 } = self;
        t_end_ns.visit(visit);
        t_ns.visit(visit);
        rate_rad_s.visit(visit);
        force_m_s2.visit(visit);
    }
}
