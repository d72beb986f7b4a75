//! Checks whether magnitudes are plausible for a body near the Earth, and finds the units that
//! explain implausible ones.

use attitude::GRAVITY_M_S2;

use crate::diagnosis::{self, Diagnosis};

/// Plausible median force, g. Steep turns reach 2 to 3 g for half a minute, and no crewed or winged
/// vehicle sustains 5 g. Confusing g and m/s² changes the force by a factor of 9.8, so it is out of
/// this range.
const PLAUSIBLE_FORCE_G: std::ops::Range<f64> = 0.5..5.0;
/// Plausible median magnetic field, µT. The Earth's field is 22 to 67 µT. Uncalibrated vehicle iron
/// can remove two thirds of it or add three times as much.
const PLAUSIBLE_FIELD_UT: std::ops::Range<f64> = 8.0..240.0;
/// Plausible median sample interval, s. Inertial sensors sample at 1.7 Hz to 50 kHz. If ms are read
/// as s, the interval is out of this range for any sensor below 1.7 kHz; if µs are read as s, it is
/// out of range for every sensor.
const PLAUSIBLE_INTERVAL_S: std::ops::Range<f64> = 20e-6..0.6;
/// The body counts as shaken if the 90 % quantile of the force exceeds the 10 % quantile by more
/// than this factor. At
/// rest the two quantiles differ by less than a tenth.
const SHAKEN_RATIO: f64 = 3.0;
/// Bounds of the 10 % and 90 % quantiles relative to the median for a steady force: a body at rest
/// or carried, without strong motion.
const STEADY_RATIOS: [f64; 2] = [0.7, 1.5];
/// Minimum observation time before the median force on a shaken body is evaluated, s. It is longer
/// than the time needed to pick the body up and put it down.
const MIN_SHAKEN_SPAN_S: f64 = 5.0;
/// Minimum number of values for a quantile: five of them are below the 10 % quantile.
const MIN_COUNT: u64 = 50;
/// The unit of time is considered wrong if more than one in `LEAP_FACTOR` samples has a clock leap.
/// A smaller share indicates isolated faults.
const LEAP_FACTOR: u64 = 2;
/// Minimum number of rejected magnetic field samples for a diagnosis, and also the minimum ratio of
/// rejected to accepted samples. If the samples are in nT, all samples are rejected as out of
/// range, while a magnet causes the rejection of only some.
const MIN_REJECTED_FIELDS: u64 = 10;

/// Quantiles of sample interval, force and magnetic field.
#[derive(Debug, Clone, Default)]
pub(crate) struct MagnitudeCheck {
    interval_s: Quantiles,
    force_m_s2: Quantiles,
    field_ut: Quantiles,
    rejected_fields: u64,
}

impl MagnitudeCheck {
    pub(crate) fn push_interval(&mut self, dt_s: f64) {
        self.interval_s.push(dt_s);
    }

    pub(crate) fn push_force(&mut self, force_m_s2: [f64; 3]) {
        self.force_m_s2.push(length(force_m_s2));
    }

    pub(crate) fn push_field(&mut self, field_ut: [f64; 3]) {
        self.field_ut.push(length(field_ut));
    }

    pub(crate) fn push_missing_field(&mut self, is_rejected: bool) {
        self.rejected_fields += u64::from(is_rejected);
    }

    pub(crate) fn diagnose_interval(&self, leaps: u64, samples: u64) -> Option<Diagnosis> {
        let median_s = self.interval_s.quantile(0.5)?;
        let is_leaping = leaps * LEAP_FACTOR > samples;
        (is_leaping || !PLAUSIBLE_INTERVAL_S.contains(&median_s))
            .then(|| diagnosis::time_unit(median_s, leaps, samples))
    }

    pub(crate) fn diagnose_force(&self, span_s: f64) -> Option<Diagnosis> {
        let [low, median, high] =
            [self.force_m_s2.quantile(0.1)?, self.force_m_s2.quantile(0.5)?, self.force_m_s2.quantile(0.9)?];
        let is_shaken = high > SHAKEN_RATIO * low;
        let is_steady = low > STEADY_RATIOS[0] * median && high < STEADY_RATIOS[1] * median;
        if PLAUSIBLE_FORCE_G.contains(&(median / GRAVITY_M_S2)) || is_shaken && span_s < MIN_SHAKEN_SPAN_S {
            return None;
        }
        Some(diagnosis::force_magnitude(low, median, high, is_steady))
    }

    pub(crate) fn diagnose_field(&self) -> Option<Diagnosis> {
        if self.rejected_fields > MIN_REJECTED_FIELDS
            && self.rejected_fields > MIN_REJECTED_FIELDS * self.field_ut.count
        {
            return Some(diagnosis::rejected_fields(self.rejected_fields));
        }
        let median_ut = self.field_ut.quantile(0.5)?;
        (!PLAUSIBLE_FIELD_UT.contains(&median_ut)).then(|| diagnosis::field_unit(median_ut)).flatten()
    }
}

/// Number of bins per decade. A bin has a relative width of 5 %, which is fine enough for every
/// bound above.
const BINS_PER_DECADE: f64 = 50.0;
/// Decimal exponent of the lowest bin. For an interval in s, the bin starts at 0.1 ns.
const MIN_EXPONENT: f64 = -10.0;
/// Number of decades, from the lowest bin to one decade above
/// [`SQUARE_SAFE_MAX`](crate::SQUARE_SAFE_MAX).
const DECADES: usize = 20;

/// Quantiles of positive numbers with a resolution of 5 %, from logarithmic bins.
#[derive(Debug, Clone)]
struct Quantiles {
    bins: Vec<u32>,
    count: u64,
}

impl Default for Quantiles {
    fn default() -> Self {
        Self { bins: vec![0; DECADES * BINS_PER_DECADE as usize], count: 0 }
    }
}

impl Quantiles {
    fn push(&mut self, x: f64) {
        // NaN and values that are not positive count in the first bin.
        let bin = ((x.log10() - MIN_EXPONENT) * BINS_PER_DECADE).max(0.0) as usize;
        let last = self.bins.len() - 1;
        self.bins[bin.min(last)] += 1;
        self.count += 1;
    }

    /// Returns the value below which `share` of the values lie, or `None` if there are too few
    /// values.
    fn quantile(&self, share: f64) -> Option<f64> {
        if self.count < MIN_COUNT {
            return None;
        }
        let mut below = 0;
        let rank = (self.count as f64 * share) as u64;
        let bin = self.bins.iter().position(|bin| {
            below += u64::from(*bin);
            below > rank
        })?;
        Some(10f64.powf((bin as f64 + 0.5) / BINS_PER_DECADE + MIN_EXPONENT))
    }
}

pub(crate) fn length(vector: [f64; 3]) -> f64 {
    attitude::Vector3::from(vector).norm()
}
