//! Sampling time of an input, estimated from its first intervals.

use crate::scalars::scalars;

/// Number of intervals that are averaged.
const MAX_INTERVALS: f64 = 16.0;
/// Sampling time assumed before the first interval, s.
pub(super) const DEFAULT_INTERVAL_S: f64 = 0.01;
/// Limits to which an interval is clamped, s.
const INTERVAL_RANGE_S: (f64, f64) = (1e-5, 1.0);

/// Mean of the first intervals of an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SamplingPeriod {
    pub(super) mean_s: f64,
    intervals: f64,
    /// Time since the last sample, s.
    pub(super) since_s: f64,
}

impl Default for SamplingPeriod {
    fn default() -> Self {
        Self { mean_s: DEFAULT_INTERVAL_S, intervals: 0.0, since_s: 0.0 }
    }
}

impl SamplingPeriod {
    /// Records a sample. Returns `true` if the mean has changed.
    pub(super) fn record_sample(&mut self) -> bool {
        let interval_s = core::mem::take(&mut self.since_s);
        if interval_s <= 0.0 || self.intervals >= MAX_INTERVALS {
            return false;
        }
        let interval_s = interval_s.clamp(INTERVAL_RANGE_S.0, INTERVAL_RANGE_S.1);
        self.intervals += 1.0;
        let first = if self.intervals > 1.0 { self.mean_s } else { interval_s };
        self.mean_s = first + (interval_s - first) / self.intervals;
        true
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let mean = (INTERVAL_RANGE_S.0..=INTERVAL_RANGE_S.1).contains(&self.mean_s);
        let count = (0.0..=MAX_INTERVALS).contains(&self.intervals) && self.since_s >= 0.0;
        (!(mean && count)).then_some("a sampling time out of range")
    }
}

scalars!(SamplingPeriod: mean_s, intervals, since_s);
