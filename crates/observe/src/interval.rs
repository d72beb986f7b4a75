//! Statistics of the intervals between messages.

use serde::Serialize;

/// Statistics of intervals, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalStats {
    /// Mean interval.
    pub mean: f64,
    /// Shortest interval.
    pub min: f64,
    /// Longest interval.
    pub max: f64,
    /// Standard deviation of the intervals.
    pub jitter: f64,
}

/// Running mean and variance of the intervals (Welford 1962), and the shortest and longest
/// interval, all in ms.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntervalAccumulator {
    pub(crate) count: f64,
    mean: f64,
    squares: f64,
    min: f64,
    max: f64,
}

impl Default for IntervalAccumulator {
    fn default() -> Self {
        Self { count: 0.0, mean: 0.0, squares: 0.0, min: f64::INFINITY, max: 0.0 }
    }
}

impl IntervalAccumulator {
    pub(crate) fn push(&mut self, ms: f64) {
        self.count += 1.0;
        let deviation = ms - self.mean;
        self.mean += deviation / self.count;
        self.squares += deviation * (ms - self.mean);
        (self.min, self.max) = (self.min.min(ms), self.max.max(ms));
    }

    /// Returns the statistics so far, or `None` before the first interval.
    pub(crate) fn stats(&self) -> Option<IntervalStats> {
        let Self { count, mean, squares, min, max } = *self;
        (count > 0.0).then(|| IntervalStats { mean, min, max, jitter: (squares / count).sqrt() })
    }
}
