//! Whether what comes in can be what it is taken for: units, signs and axes of the sensors, judged before they are believed.
//!
//! Input: samples as they are about to be fused, after calibration and mounting. Output: findings, each once, with figures and
//! remedies; nothing is changed. Time: the samples' own. Memory: bounded. Failure: none; what is not finite is passed over.
//!
//! | module | what it judges |
//! | --- | --- |
//! | [`finding`] | what is said, and the remedies |
//! | `fields` | fields on their way to their samples |
//! | `sizes` | magnitudes of force, field and interval: their units |
//! | `spinning` | whether the gyro tells of turns that gravity does not show |
//! | `turning` | whether the gyro turns gravity as the accelerometer sees it |
//! | `uprightness` | where gravity points |
//! | `axes` | axes that stand still or end at their range |
#![forbid(unsafe_code)]

mod axes;
mod fields;
pub mod finding;
mod sizes;
mod spinning;
mod turning;
mod uprightness;

use messages::{Flags, ImuSample, MagSample};

use axes::Axes;
pub use fields::Fields;
pub use finding::{Candidate, Finding, Mistake};
use sizes::Sizes;
use spinning::Spinning;
use turning::Turning;
use uprightness::Uprightness;

/// Between two looks at what has been gathered, s of the samples' time: the first word comes within seconds, as long as a window of `turning` takes.
const LOOK_S: f64 = 2.0;
/// Samples that a look needs, in all and since the one before: the tenth part of fewer is no quantile.
const LOOK_SAMPLES: u64 = 100;
/// Samples before the first look: times in a wrong unit make seconds of few.
const FIRST_SAMPLES: u64 = 200;
/// It ends after so much motion that can be judged, s: thirty windows, ten times what a finding needs.
const MOTION_S: f64 = 60.0;
/// It ends after so long, s: who has not moved by then is not waited for.
const SPAN_MAX_S: f64 = 120.0;
/// It ends after so many samples, whatever their times: a minute at 8 kHz.
const SAMPLES_MAX: u64 = 500_000;
/// A number beyond it is not judged: its square and products of squares must stay finite.
const SENSE: f64 = 1e9;
/// Rates at the end of the range that °/s make: a body that is thrown has a few.
const CLIPPED_MIN: u64 = 50;
/// Rates so far beyond the range that they were refused: no gyro gives one, and a spike on the wire is single.
const SENSELESS_MIN: u64 = 5;
/// Samples told to be refused or out of order before it is worth a word: a start and a restart of the device make one each.
const STAMPS_MIN: u64 = 3;
/// Rates that no gyro ends below, rad/s: the smallest usual range is 125 °/s.
const RATE_RANGE_MIN_RAD_S: f64 = 2.0;
/// Forces that no accelerometer ends below, m/s²: the smallest usual range is 2 g, less its error.
const FORCE_RANGE_MIN_M_S2: f64 = 15.0;

/// Gathers samples and says what is wrong with them.
#[derive(Debug, Clone)]
pub struct Judge {
    sizes: Sizes,
    turning: Turning,
    spinning: Spinning,
    uprightness: Uprightness,
    rate: Axes,
    force: Axes,
    samples: u64,
    next_tick: u64,
    first_ns: Option<i64>,
    span_s: f64,
    looked: (f64, u64),
    rates_clipped: u64,
    rates_senseless: u64,
    refused: u64,
    leaps: u64,
    told: Vec<Mistake>,
    ended: bool,
}

impl Default for Judge {
    fn default() -> Self {
        Self {
            sizes: Sizes::default(),
            turning: Turning::default(),
            spinning: Spinning::default(),
            uprightness: Uprightness::default(),
            rate: Axes::new("rate", "gyro", RATE_RANGE_MIN_RAD_S),
            force: Axes::new("force", "accelerometer", FORCE_RANGE_MIN_M_S2),
            samples: 0,
            next_tick: 0,
            first_ns: None,
            span_s: 0.0,
            looked: (0.0, 0),
            rates_clipped: 0,
            rates_senseless: 0,
            refused: 0,
            leaps: 0,
            told: Vec::new(),
            ended: false,
        }
    }
}

impl Judge {
    /// Takes a sample, and the field where one came with it. Gives what is found by it and was not told before: usually nothing.
    pub fn take(&mut self, imu: &ImuSample, mag: Option<&MagSample>) -> Vec<Finding> {
        let tick = imu.header.tick;
        // A source that was started again gives again what it had given.
        if self.ended || tick < self.next_tick || imu.header.flags.any(Flags::FAULT_INJECTED) {
            return Vec::new();
        }
        if tick > self.next_tick {
            self.interrupt();
        }
        self.next_tick = tick + 1;
        self.gather(imu, mag);
        let due = self.samples >= FIRST_SAMPLES
            && self.span_s - self.looked.0 >= LOOK_S
            && self.samples - self.looked.1 >= LOOK_SAMPLES;
        let over = self.samples >= FIRST_SAMPLES && self.span_s >= SPAN_MAX_S
            || self.turning.seconds() >= MOTION_S
            || self.samples >= SAMPLES_MAX;
        if over {
            return self.finish();
        }
        if due { self.look() } else { Vec::new() }
    }

    /// It has said all that it will.
    pub fn is_ended(&self) -> bool {
        self.ended
    }

    /// What is found at the end of the samples and was not told before.
    pub fn finish(&mut self) -> Vec<Finding> {
        if self.ended {
            return Vec::new();
        }
        self.ended = true;
        self.look()
    }

    fn gather(&mut self, imu: &ImuSample, mag: Option<&MagSample>) {
        let flags = imu.header.flags;
        self.samples += 1;
        self.refused += u64::from(flags.any(Flags::REFUSED_BEFORE));
        self.rates_clipped += u64::from(flags.any(Flags::RATE_CLIPPED));
        self.rates_senseless += u64::from(flags.any(Flags::RATE_INVALID));
        self.leaps += u64::from(flags.any(Flags::CLOCK_LEAP));
        let first_ns = *self.first_ns.get_or_insert(imu.header.t_end_ns);
        self.span_s = imu.header.t_end_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let dt_s = imu.header.t_end_ns.saturating_sub(imu.header.t_start_ns) as f64 * 1e-9;
        if self.samples > 1 {
            self.sizes.interval(dt_s);
        }
        match mag {
            Some(mag) if is_sensible(mag.field_ut) => {
                self.sizes.field(mag.field_ut);
                self.uprightness.field(mag.field_ut);
            }
            Some(_) => {}
            None => self.sizes.field_refused(flags.any(Flags::FIELD_INVALID)),
        }
        if !is_sensible(imu.rate_rad_s) || !is_sensible(imu.force_m_s2) {
            return self.interrupt();
        }
        if !flags.any(Flags::RATE_INVALID) {
            self.rate.take(imu.rate_rad_s);
        }
        if flags.any(Flags::FORCE_INVALID) {
            return self.interrupt();
        }
        self.force.take(imu.force_m_s2);
        self.sizes.force(imu.force_m_s2);
        if flags.any(Flags::RATE_INVALID | Flags::GAP | Flags::CLOCK_LEAP | Flags::FORCE_STUCK) {
            return self.interrupt();
        }
        self.uprightness.take(dt_s, imu.rate_rad_s, imu.force_m_s2);
        self.turning.take(dt_s, imu.rate_rad_s, imu.force_m_s2);
        self.spinning.take(dt_s, imu.rate_rad_s, imu.force_m_s2);
    }

    /// What came before does not go on.
    fn interrupt(&mut self) {
        self.turning.interrupt();
        self.spinning.interrupt();
    }

    fn look(&mut self) -> Vec<Finding> {
        self.looked = (self.span_s, self.samples);
        if self.samples < LOOK_SAMPLES {
            return Vec::new();
        }
        let mut found = Vec::new();
        found.extend(self.sizes.interval_finding(self.leaps, self.samples));
        let time_is_wrong = !found.is_empty();
        if !time_is_wrong && self.refused + self.leaps >= STAMPS_MIN {
            found.push(finding::stamps(self.refused, self.leaps, self.samples));
        }
        found.extend(self.sizes.force_finding(self.span_s));
        let force_is_whole = !found.iter().any(|finding| finding.mistake == Mistake::GravityRemoved);
        found.extend(self.sizes.field_finding());
        if !time_is_wrong && force_is_whole {
            found.extend(self.turning.finding());
            if found.iter().all(|finding| !finding.mistake.is_of_turning()) {
                found.extend(self.spinning.finding());
            }
            if found.iter().all(|finding| !finding.mistake.is_of_turning())
                && self.rates_clipped >= CLIPPED_MIN
                && self.rates_senseless >= SENSELESS_MIN
            {
                found.push(finding::rates_beyond(self.rates_clipped, self.rates_senseless));
            }
            found.extend(self.uprightness.finding());
        }
        let rate_is_wrong = found.iter().any(|finding| finding.mistake == Mistake::RateUnit);
        let turned = self.turning.is_enough();
        found.extend(self.rate.finding(turned, rate_is_wrong));
        found.extend(self.force.finding(turned, false));
        found.retain(|finding| !self.told.contains(&finding.mistake));
        self.told.extend(found.iter().map(|finding| finding.mistake));
        found
    }
}

fn is_sensible(vector: [f64; 3]) -> bool {
    vector.iter().all(|x| x.abs() < SENSE)
}

/// What stamps show that nobody has conditioned yet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Stamps {
    /// Equal to the one before.
    pub doubled: u64,
    /// Earlier than the one before.
    pub disordered: u64,
    last_ns: Option<i64>,
}

impl Stamps {
    /// Takes the stamp of a reading, ns.
    pub fn take(&mut self, t_ns: i64) {
        if let Some(last_ns) = self.last_ns.replace(t_ns) {
            self.doubled += u64::from(t_ns == last_ns);
            self.disordered += u64::from(t_ns < last_ns);
        }
    }
}

fn length(vector: [f64; 3]) -> f64 {
    attitude::Vector3::from(vector).norm()
}
