//! Magnitudes that a body near the earth has, and the units that make others of them.

use attitude::GRAVITY_M_S2;

use crate::{
    finding::{self, Finding},
    length,
};

/// The median force may be so many times gravity without a word: steep turns have 2 to 3 g for half a minute, nothing with people or wings has 5 g
/// for long, and g for m/s² is a factor of 9.8.
const FORCE_USUAL: std::ops::Range<f64> = 0.5..5.0;
/// The earth's field is 22 to 67 µT; iron of a vehicle that is not calibrated takes two thirds of it away or adds three times as much.
const FIELD_USUAL_UT: std::ops::Range<f64> = 8.0..240.0;
/// Median intervals, s: no inertial sensor is faster than 50 kHz or slower than 1.7 Hz; ms for s is beyond it for all below 1.7 kHz, µs for s for all.
const INTERVAL_USUAL_S: std::ops::Range<f64> = 20e-6..0.6;
/// A force that is so many times another of the same seconds is of a body that is shaken: at rest the two are within a tenth.
const SHAKEN: f64 = 3.0;
/// A force is steady whose tenth and nine tenths are within these of its median: a body that stands or is carried, and not motion alone.
const STEADY: [f64; 2] = [0.7, 1.5];
/// A shaken body is watched for so long before its median is believed, s: longer than it is picked up and put down.
const SHAKEN_S: f64 = 5.0;
/// Samples that a quantile needs: five are below the tenth part.
const COUNT_MIN: u64 = 50;
/// Stamps that leap in more than each second sample are no single faults: the unit is wrong.
const LEAPT: u64 = 2;
/// Fields refused before it is worth a word, and so many times more than were taken: in nT all are beyond the limit, a magnet brings some.
const REFUSED_MIN: u64 = 10;

/// Medians of what comes in.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sizes {
    interval_s: Quantiles,
    force_m_s2: Quantiles,
    field_ut: Quantiles,
    fields_refused: u64,
}

impl Sizes {
    pub(crate) fn interval(&mut self, dt_s: f64) {
        self.interval_s.take(dt_s);
    }

    pub(crate) fn force(&mut self, force_m_s2: [f64; 3]) {
        self.force_m_s2.take(length(force_m_s2));
    }

    pub(crate) fn field(&mut self, field_ut: [f64; 3]) {
        self.field_ut.take(length(field_ut));
    }

    pub(crate) fn field_refused(&mut self, refused: bool) {
        self.fields_refused += u64::from(refused);
    }

    pub(crate) fn interval_finding(&self, leaps: u64, samples: u64) -> Option<Finding> {
        let median_s = self.interval_s.at(0.5)?;
        let leapt = leaps * LEAPT > samples;
        (leapt || !INTERVAL_USUAL_S.contains(&median_s)).then(|| finding::time_unit(median_s, leaps, samples))
    }

    pub(crate) fn force_finding(&self, span_s: f64) -> Option<Finding> {
        let [low, median, high] = [self.force_m_s2.at(0.1)?, self.force_m_s2.at(0.5)?, self.force_m_s2.at(0.9)?];
        let is_shaken = high > SHAKEN * low;
        let is_steady = low > STEADY[0] * median && high < STEADY[1] * median;
        if FORCE_USUAL.contains(&(median / GRAVITY_M_S2)) || is_shaken && span_s < SHAKEN_S {
            return None;
        }
        Some(finding::force_size(low, median, high, is_steady))
    }

    pub(crate) fn field_finding(&self) -> Option<Finding> {
        if self.fields_refused > REFUSED_MIN && self.fields_refused > REFUSED_MIN * self.field_ut.count {
            return Some(finding::field_refused(self.fields_refused));
        }
        let median_ut = self.field_ut.at(0.5)?;
        (!FIELD_USUAL_UT.contains(&median_ut)).then(|| finding::field_unit(median_ut)).flatten()
    }
}

/// Bins of a decade: 5 % each, far finer than any bound above.
const PER_DECADE: f64 = 50.0;
/// The least exponent of ten: a tenth of a nanosecond.
const LEAST: f64 = -10.0;
/// Decades above it: to what [`SENSE`](crate::SENSE) lets in, and one more.
const DECADES: usize = 20;

/// Quantiles of positive numbers to 5 %, from logarithmic bins.
#[derive(Debug, Clone)]
struct Quantiles {
    bins: Vec<u32>,
    count: u64,
}

impl Default for Quantiles {
    fn default() -> Self {
        Self { bins: vec![0; DECADES * PER_DECADE as usize], count: 0 }
    }
}

impl Quantiles {
    fn take(&mut self, x: f64) {
        // What is not a number, or not above zero, falls into the first bin.
        let place = ((x.log10() - LEAST) * PER_DECADE).max(0.0) as usize;
        let last = self.bins.len() - 1;
        self.bins[place.min(last)] += 1;
        self.count += 1;
    }

    /// The value that this share is below; `None` while there are few.
    fn at(&self, share: f64) -> Option<f64> {
        if self.count < COUNT_MIN {
            return None;
        }
        let mut below = 0;
        let wanted = (self.count as f64 * share) as u64;
        let place = self.bins.iter().position(|bin| {
            below += u64::from(*bin);
            below > wanted
        })?;
        Some(10f64.powf((place as f64 + 0.5) / PER_DECADE + LEAST))
    }
}
