//! The time between messages: mean, extremes, jitter.

use serde::Serialize;

/// Intervals, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// Mean.
    pub mean: f64,
    /// Shortest.
    pub min: f64,
    /// Longest.
    pub max: f64,
    /// Standard deviation: the jitter.
    pub jitter: f64,
}

/// Mean and variance as they come (Welford 1962), and the extremes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Intervals {
    pub(crate) count: f64,
    mean: f64,
    squares: f64,
    min: f64,
    max: f64,
}

impl Default for Intervals {
    fn default() -> Self {
        Self { count: 0.0, mean: 0.0, squares: 0.0, min: f64::INFINITY, max: 0.0 }
    }
}

impl Intervals {
    /// Takes the next.
    pub(crate) fn add(&mut self, ms: f64) {
        self.count += 1.0;
        let off = ms - self.mean;
        self.mean += off / self.count;
        self.squares += off * (ms - self.mean);
        (self.min, self.max) = (self.min.min(ms), self.max.max(ms));
    }

    /// What they have been; `None` before the first.
    pub(crate) fn report(&self) -> Option<Interval> {
        let Self { count, mean, squares, min, max } = *self;
        (count > 0.0).then(|| Interval { mean, min, max, jitter: (squares / count).sqrt() })
    }
}
