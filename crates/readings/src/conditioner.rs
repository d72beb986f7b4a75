//! Converts readings to checked samples: each accepted reading becomes a tick.
//!
//! Input: readings as reported by the sensors, after the faults that the launch file injects. They
//! are checked in sensor axes. If the calibration converts their unit, such as that of raw counts,
//! the limits apply after the calibration. The mounting is applied last.
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
//! | a field that is not finite or at the end of the range; an implausible fix | omitted, flagged |
//! | a field equal to the previous one | no new field sample |
//! | a value at the end of the range | unchanged, flagged |
//! | \|f\| near zero | unchanged; flagged and ignored by accel |
//! | the same vector for `stuck_s` | unchanged, flagged; a stuck force is ignored while the rate still varies |
//! | the stamp and values of the previous reading | rejected |
//! | the stamp of the previous reading with other values | a sample one typical interval later, flagged |
//! | a later stamp after such samples, but before the end of the newest sample | half a typical interval, flagged, until time agrees with the stamps |
//! | a stamp before the previous one | rejected; if the next stamp is later than the rejected one, the clock was set back: time continues, flagged |
//! | a stamp more than `gap_s` after the previous one | a sample after a gap, flagged; if the gap exceeds 1 s, the level is initialised again |
//! | a stamp more than 10 s after the previous one | the clock leapt: time continues, flagged |

use attitude::{
    Matrix3, Quaternion,
    calibration::{Calibration, CalibrationError, Mounting},
    magnetometer::RepeatFilter,
};
use launch::{GyroSamples, Ingest};
use messages::{Flags, GnssFix, Header, ImuSample, MagSample};

use crate::{
    channel::{FieldChannel, VectorChannel, check_fix},
    fault_injection::FaultInjector,
    source::{Reading, ReceiverFix, Truth},
};

/// Longest step between timestamps that counts as a gap, ns. A longer step is a leap of the clock.
const MAX_GAP_NS: i64 = 10_000_000_000;
/// Maximum magnitude of the first stamp, ns (285 years), so that time can run for years without
/// overflow.
const MAX_START_NS: i64 = 9_000_000_000_000_000_000;
/// Maximum number of consecutive backward timestamps that are rejected. After that, the sensor's
/// clock is considered set back, and the sample time continues.
const MAX_BACKWARD_STAMPS: i64 = 10;

/// Sample of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Rate and force.
    pub imu: ImuSample,
    /// Magnetic field, if the reading has a new valid one.
    pub mag: Option<MagSample>,
    /// Fix, if one arrived and is valid.
    pub gnss: Option<GnssFix>,
    /// True attitude of the body, if the source provides the true attitude of the sensor axes.
    pub reference: Option<Truth>,
}

/// Conditioner that checks the readings of a source and numbers the samples.
#[derive(Debug, Clone)]
pub struct Conditioner {
    fault_injector: FaultInjector,
    /// `true` if a fault was injected since the last sample.
    has_injected_fault: bool,
    rate: VectorChannel,
    force: VectorChannel,
    field: FieldChannel,
    /// Fix to pass on with the next sample, because its own reading was rejected.
    pending_fix: Option<ReceiverFix>,
    transform: BodyTransform,
    gap_ns: i64,
    rate_kind_flag: Flags,
    tick: u64,
    /// Sample time minus sensor time, ns.
    offset_ns: i64,
    typical_interval_ns: i64,
    last: Option<LastSample>,
    /// Stamp of the previous reading and the number of readings rejected in a row, if the previous
    /// reading was rejected as outdated.
    backward_run: Option<(i64, i64)>,
    rejected: u64,
    rejected_before: bool,
    /// `true` if the conditioner resumes from the state of an earlier conditioner.
    is_resumed: bool,
}

/// Transform from sensor axes to body axes.
#[derive(Debug, Clone)]
struct BodyTransform {
    mounting: Mounting,
    gyro: Calibration,
    accel: Calibration,
    mag: Calibration,
}

fn to_body(mounting: &Mounting, calibration: &Calibration, raw: [f64; 3]) -> [f64; 3] {
    mounting.apply(calibration.apply(raw.into())).into()
}

fn truth_to_body(mounting: &Mounting, truth: Truth) -> Truth {
    let [w, x, y, z] = truth.quaternion;
    let body = mounting.attitude(Quaternion::new(w, x, y, z));
    Truth { quaternion: [body.w, body.i, body.j, body.k], ..truth }
}

fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}

#[derive(Debug, Clone, Copy)]
struct LastSample {
    t_end_ns: i64,
    reading: Reading,
}

impl Conditioner {
    /// Creates a conditioner for sensors that sample at `rate_hz`. Limits, calibration and mounting
    /// are taken from `ingest`.
    ///
    /// # Errors
    ///
    /// Returns an error if a calibration or the mounting is invalid.
    pub fn new(ingest: &Ingest, rate_hz: f64, kind: GyroSamples) -> Result<Self, CalibrationError> {
        let limits = &ingest.limits;
        let stuck_ns = (limits.stuck_s * 1e9) as i64;
        let gap_ns = (limits.gap_s * 1e9) as i64;
        Ok(Self {
            fault_injector: FaultInjector::new(&ingest.faults),
            has_injected_fault: false,
            rate: VectorChannel {
                limit: limits.rate_max_deg_s.to_radians(),
                invalid: Flags::RATE_INVALID,
                clipped: Flags::RATE_CLIPPED,
                stuck: Flags::RATE_STUCK,
                stuck_ns,
                ..VectorChannel::default()
            },
            force: VectorChannel {
                limit: limits.force_max_g * attitude::GRAVITY_M_S2,
                invalid: Flags::FORCE_INVALID,
                clipped: Flags::FORCE_CLIPPED,
                stuck: Flags::FORCE_STUCK,
                stuck_ns,
                ..VectorChannel::default()
            },
            field: FieldChannel { limit_ut: limits.field_max_ut, repeat_filter: RepeatFilter::default() },
            pending_fix: None,
            transform: BodyTransform {
                mounting: Mounting::from_matrix(matrix(ingest.mounting))?,
                gyro: ingest.calibration.gyro.to_calibration()?,
                accel: ingest.calibration.accel.to_calibration()?,
                mag: ingest.calibration.mag.to_calibration()?,
            },
            gap_ns,
            rate_kind_flag: Flags::RATE_INSTANT.when(kind == GyroSamples::Instants),
            tick: 0,
            offset_ns: 0,
            typical_interval_ns: (1e9 / rate_hz) as i64,
            last: None,
            backward_run: None,
            rejected: 0,
            rejected_before: false,
            is_resumed: false,
        })
    }

    /// Returns the sample of a reading, or `None` if it is rejected or dropped by an injected
    /// fault.
    pub fn condition(&mut self, reading: &Reading) -> Option<Sample> {
        let (reading, is_active) = self.fault_injector.inject(&reading.without_negative_zero())?;
        self.has_injected_fault |= is_active;
        self.check(&reading)
    }

    fn check(&mut self, reading: &Reading) -> Option<Sample> {
        self.pending_fix = reading.fix.or(self.pending_fix);
        let Some((t_start_ns, t_end_ns, time_flags)) = self.assign_interval(reading) else {
            self.rejected += 1;
            self.rejected_before = true;
            return None;
        };
        let dt_ns = t_end_ns - t_start_ns;
        let BodyTransform { mounting, gyro, accel, mag } = &self.transform;
        let (rate_rad_s, rate_flags) = self.rate.check(reading.rate_rad_s, gyro, dt_ns);
        let (force_m_s2, force_flags) = self.force.check(reading.force_m_s2, accel, dt_ns);
        let is_rate_lost = self.rate.invalid_ns > self.gap_ns;
        let rate_rad_s = if is_rate_lost { [0.0; 3] } else { to_body(mounting, gyro, rate_rad_s) };
        let force_m_s2 = to_body(mounting, accel, force_m_s2);
        let (field_ut, field_flags) = self.field.check(reading.field_ut, mag);
        let (fix, fix_flags) = check_fix(self.pending_fix.take());
        let rejected = Flags::REFUSED_BEFORE.when(std::mem::take(&mut self.rejected_before));
        let injected = Flags::FAULT_INJECTED.when(std::mem::take(&mut self.has_injected_fault));
        let value_flags = rate_flags | force_flags | field_flags | fix_flags;
        let flags = time_flags | value_flags | rejected | injected | self.rate_kind_flag;
        let header = Header { tick: self.tick, t_start_ns, t_end_ns, flags, ..bytemuck::Zeroable::zeroed() };
        self.tick += 1;
        self.last = Some(LastSample { t_end_ns, reading: *reading });
        Some(Sample {
            imu: ImuSample { header, rate_rad_s, force_m_s2 },
            mag: field_ut.map(|field_ut| MagSample { header, field_ut: to_body(mounting, mag, field_ut) }),
            gnss: fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| GnssFix {
                header,
                velocity_m_s: fix.velocity_m_s.into(),
                velocity_sd_m_s: fix.sd_m_s.unwrap_or(f64::NAN),
                age_s: fix.age_s.unwrap_or(f64::NAN),
                latitude_rad: fix.latitude_rad.unwrap_or(f64::NAN),
                longitude_rad: longitude_rad.unwrap_or(f64::NAN),
                altitude_m: altitude_m.unwrap_or(f64::NAN),
            }),
            reference: reading.reference.map(|truth| truth_to_body(mounting, truth)),
        })
    }

    /// Resumes at `tick` with the [`offset_ns`](Self::offset_ns) of an earlier conditioner. The
    /// next sample follows a gap.
    pub fn resume_at(&mut self, tick: u64, offset_ns: i64) {
        (self.tick, self.offset_ns, self.is_resumed) = (tick, offset_ns, true);
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
        let is_same_stamp = reading.t_ns == last.reading.t_ns;
        if is_same_stamp && is_repeated(reading, &last.reading) {
            return None;
        }
        let dt_ns = reading.t_ns.saturating_add(self.offset_ns).saturating_sub(last.t_end_ns);
        let mut catches_up = false;
        let (dt_ns, flags) = match dt_ns {
            1..=MAX_GAP_NS => (dt_ns, Flags::GAP.when(dt_ns > self.gap_ns)),
            // Readings with the previous stamp have brought the sample time forward too far.
            ..=0 if reading.t_ns > last.reading.t_ns && dt_ns >= -self.gap_ns => {
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

    /// Returns the interval to use (ns) if it is certain that the clock was set back, and otherwise
    /// `None`.
    ///
    /// A stamp is outdated if it is earlier than that of the last accepted reading. The clock was
    /// certainly set back after two consecutive outdated stamps in increasing order, or after
    /// [`MAX_BACKWARD_STAMPS`] outdated stamps in any order.
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

/// Returns `true` if both readings have the same rate and force, bit for bit.
fn is_repeated(reading: &Reading, before: &Reading) -> bool {
    let bits = |reading: &Reading| (reading.rate_rad_s.map(f64::to_bits), reading.force_m_s2.map(f64::to_bits));
    bits(reading) == bits(before)
}
