//! From readings to checked samples: every reading that can be placed in time becomes a tick.
//!
//! Input: readings as a sensor gives them, or as the launch file's script of faults has them; what is wrong with them is judged before calibration and mounting are applied. Output: samples with finite values, growing time and contiguous ticks, with flags for what
//! is wrong. Time: the readings' own. Failure: a reading that came twice or belongs to the past is refused and counted.
//!
//! | reading | becomes |
//! | --- | --- |
//! | a rate or force that is not finite, or beyond all sense | the last good one, flagged; the rate 0 after `gap_s` |
//! | a field that is not finite or at the end of the range; a fix without sense | left out, flagged |
//! | the same field as before | no new sample of it |
//! | at the end of the range | as it is, flagged |
//! | \|f\| near zero | as it is, flagged by accel; not used |
//! | the same vector for `stuck_s` | as it is, flagged; a force that is stuck while the rate lives is not used |
//! | the same stamp and values again | refused |
//! | the same stamp, other values | a sample one usual interval later, flagged |
//! | an earlier stamp | refused; when the next goes on from there, the clock was set back: time continues, flagged |
//! | a stamp later by more than `gap_s` | a sample after a gap, flagged; beyond 1 s the level is set anew |
//! | a stamp later by more than 10 s | the clock leapt: time continues, flagged |

use attitude::{
    Matrix3, Quaternion,
    calibration::{Calibration, CalibrationError, Mounting},
};
use launch::{GyroSamples, Ingest};
use messages::{Flags, GnssFix, Header, ImuSample, MagSample};

use crate::{
    channel::{Channel, FieldChannel, checked},
    script::Script,
    source::{Reading, ReceiverFix, Truth},
};

/// A stamp farther ahead than this is a leap of the clock, not a gap, ns.
const LEAP_NS: i64 = 10_000_000_000;
/// The first stamp is taken no farther from zero than this, so that time has room to grow for years, ns: 285 years.
const MAX_START_NS: i64 = 9_000_000_000_000_000_000;
/// Earlier stamps refused in a row before the sensor's clock is taken as broken and time goes on without it.
const MAX_PAST: i64 = 10;

/// What becomes of a reading: one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Rate and force.
    pub imu: ImuSample,
    /// The field, where the reading brought a new one.
    pub mag: Option<MagSample>,
    /// The fix, where the reading brought one.
    pub gnss: Option<GnssFix>,
    /// The true attitude of the body, where the source knows that of its axes.
    pub reference: Option<Truth>,
}

/// Checks readings and numbers them.
#[derive(Debug, Clone)]
pub struct Conditioner {
    script: Script,
    /// The script was at work since the last sample.
    scripted: bool,
    rate: Channel,
    force: Channel,
    field: FieldChannel,
    /// Of a reading that was refused; it goes with the next.
    fix: Option<ReceiverFix>,
    body: Body,
    gap_ns: i64,
    kind: Flags,
    tick: u64,
    /// Ours less the sensor's.
    offset_ns: i64,
    usual_ns: i64,
    last: Option<Last>,
    /// The stamp of the refused reading before this one, and how many were refused in a row.
    past: Option<(i64, i64)>,
    refused: u64,
    refused_before: bool,
    /// It goes on for another.
    continued: bool,
}

/// From the sensors' axes to the body's.
#[derive(Debug, Clone)]
struct Body {
    mounting: Mounting,
    gyro: Calibration,
    accel: Calibration,
    mag: Calibration,
}

fn in_body(mounting: &Mounting, calibration: &Calibration, raw: [f64; 3]) -> [f64; 3] {
    mounting.apply(calibration.apply(raw.into())).into()
}

fn of_body(mounting: &Mounting, truth: Truth) -> Truth {
    let [w, x, y, z] = truth.quaternion;
    let body = mounting.attitude(Quaternion::new(w, x, y, z));
    Truth { quaternion: [body.w, body.i, body.j, body.k], ..truth }
}

fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}

#[derive(Debug, Clone, Copy)]
struct Last {
    t_end_ns: i64,
    reading: Reading,
}

impl Conditioner {
    /// For sensors of this rate, limited, calibrated and mounted as `ingest` says.
    pub fn new(ingest: &Ingest, rate_hz: f64, kind: GyroSamples) -> Result<Self, CalibrationError> {
        let limits = &ingest.limits;
        let stuck_ns = (limits.stuck_s * 1e9) as i64;
        let gap_ns = (limits.gap_s * 1e9) as i64;
        Ok(Self {
            script: Script::new(&ingest.faults),
            scripted: false,
            rate: Channel {
                limit: limits.rate_max_deg_s.to_radians(),
                invalid: Flags::RATE_INVALID,
                clipped: Flags::RATE_CLIPPED,
                stuck: Flags::RATE_STUCK,
                stuck_ns,
                ..Channel::default()
            },
            force: Channel {
                limit: limits.force_max_g * attitude::GRAVITY_M_S2,
                invalid: Flags::FORCE_INVALID,
                clipped: Flags::FORCE_CLIPPED,
                stuck: Flags::FORCE_STUCK,
                stuck_ns,
                ..Channel::default()
            },
            field: FieldChannel { limit_ut: limits.field_max_ut, last_ut: None },
            fix: None,
            body: Body {
                mounting: Mounting::from_matrix(matrix(ingest.mounting))?,
                gyro: ingest.calibration.gyro.to_calibration()?,
                accel: ingest.calibration.accel.to_calibration()?,
                mag: ingest.calibration.mag.to_calibration()?,
            },
            gap_ns,
            kind: Flags::RATE_INSTANT.when(kind == GyroSamples::Instants),
            tick: 0,
            offset_ns: 0,
            usual_ns: (1e9 / rate_hz) as i64,
            last: None,
            past: None,
            refused: 0,
            refused_before: false,
            continued: false,
        })
    }

    /// The sample of a reading; `None` when it is refused, or gone by the script of faults.
    pub fn condition(&mut self, reading: &Reading) -> Option<Sample> {
        let (reading, at_work) = self.script.distort(&reading.without_negative_zero())?;
        self.scripted |= at_work;
        self.judge(&reading)
    }

    fn judge(&mut self, reading: &Reading) -> Option<Sample> {
        self.fix = reading.fix.or(self.fix);
        let Some((t_start_ns, t_end_ns, time_flags)) = self.place(reading) else {
            self.refused += 1;
            self.refused_before = true;
            return None;
        };
        let dt_ns = t_end_ns - t_start_ns;
        let (rate_rad_s, rate_flags) = self.rate.check(reading.rate_rad_s, dt_ns);
        let (force_m_s2, force_flags) = self.force.check(reading.force_m_s2, dt_ns);
        let dead = self.rate.invalid_ns > self.gap_ns;
        let Body { mounting, gyro, accel, mag } = &self.body;
        let rate_rad_s = if dead { [0.0; 3] } else { in_body(mounting, gyro, rate_rad_s) };
        let force_m_s2 = in_body(mounting, accel, force_m_s2);
        let (field_ut, field_flags) = self.field.check(reading.field_ut);
        let (fix, fix_flags) = checked(self.fix.take());
        let refused = Flags::REFUSED_BEFORE.when(std::mem::take(&mut self.refused_before));
        let scripted = Flags::FAULT_INJECTED.when(std::mem::take(&mut self.scripted));
        let flags = time_flags | rate_flags | force_flags | field_flags | fix_flags | refused | scripted | self.kind;
        let header = Header { tick: self.tick, t_start_ns, t_end_ns, flags, ..bytemuck::Zeroable::zeroed() };
        self.tick += 1;
        self.last = Some(Last { t_end_ns, reading: *reading });
        Some(Sample {
            imu: ImuSample { header, rate_rad_s, force_m_s2 },
            mag: field_ut.map(|field_ut| MagSample { header, field_ut: in_body(mounting, mag, field_ut) }),
            gnss: fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| GnssFix {
                header,
                velocity_m_s: fix.velocity_m_s.into(),
                velocity_sd_m_s: fix.sd_m_s.unwrap_or(f64::NAN),
                age_s: fix.age_s.unwrap_or(f64::NAN),
                latitude_rad: fix.latitude_rad.unwrap_or(f64::NAN),
                longitude_rad: longitude_rad.unwrap_or(f64::NAN),
                altitude_m: altitude_m.unwrap_or(f64::NAN),
            }),
            reference: reading.reference.map(|truth| of_body(mounting, truth)),
        })
    }

    /// Goes on for a conditioner that ended before `tick` and had this [`offset_ns`](Self::offset_ns); the next sample follows a gap.
    pub fn continue_at(&mut self, tick: u64, offset_ns: i64) {
        (self.tick, self.offset_ns, self.continued) = (tick, offset_ns, true);
    }

    /// Time of the samples less the sensor's, ns.
    pub fn offset_ns(&self) -> i64 {
        self.offset_ns
    }

    /// Ticks given so far.
    pub fn ticks(&self) -> u64 {
        self.tick
    }

    /// Readings refused so far.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The interval of a reading, and what is to be said about it.
    fn place(&mut self, reading: &Reading) -> Option<(i64, i64, Flags)> {
        let Some(last) = self.last else {
            if self.continued {
                let t_ns = reading.t_ns.saturating_add(self.offset_ns);
                return Some((t_ns, t_ns, Flags::GAP));
            }
            let t_ns = reading.t_ns.clamp(-MAX_START_NS, MAX_START_NS);
            self.offset_ns = t_ns - reading.t_ns;
            return Some((t_ns, t_ns, Flags::CLOCK_LEAP.when(self.offset_ns != 0)));
        };
        let stands = reading.t_ns == last.reading.t_ns;
        if stands && is_repeated(reading, &last.reading) {
            return None;
        }
        let dt_ns = reading.t_ns.saturating_add(self.offset_ns).saturating_sub(last.t_end_ns);
        let (dt_ns, flags) = match dt_ns {
            1..=LEAP_NS => (dt_ns, Flags::GAP.when(dt_ns > self.gap_ns)),
            _ if dt_ns < 0 && !stands => (self.set_back(reading.t_ns)?, Flags::CLOCK_LEAP),
            _ => (self.usual_ns, Flags::CLOCK_LEAP),
        };
        self.past = None;
        if flags == Flags::NONE {
            self.usual_ns += (dt_ns - self.usual_ns) / 16;
        }
        let t_end_ns = last.t_end_ns.checked_add(dt_ns)?;
        if flags.any(Flags::CLOCK_LEAP) && !stands {
            self.offset_ns = t_end_ns.saturating_sub(reading.t_ns);
        }
        Some((last.t_end_ns, t_end_ns, flags))
    }

    /// An earlier stamp: the interval to continue with when the clock was set back, as a second such stamp in order shows.
    fn set_back(&mut self, t_ns: i64) -> Option<i64> {
        match self.past {
            Some((before_ns, count))
                if (1..=self.gap_ns).contains(&t_ns.saturating_sub(before_ns)) || count >= MAX_PAST =>
            {
                Some(self.usual_ns.saturating_mul(count + 1))
            }
            past => {
                self.past = Some((t_ns, past.map_or(1, |(_, count)| count + 1)));
                None
            }
        }
    }
}

/// The sensor said the same again, to the last bit.
fn is_repeated(reading: &Reading, before: &Reading) -> bool {
    let bits = |reading: &Reading| (reading.rate_rad_s.map(f64::to_bits), reading.force_m_s2.map(f64::to_bits));
    bits(reading) == bits(before)
}
