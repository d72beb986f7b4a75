//! The sampling time of an input, from its first intervals.

use crate::numbers::Numbers;

/// Intervals that make the sampling time.
const INTERVALS: f64 = 16.0;
/// The sampling time before the first interval, s.
pub(super) const FIRST_INTERVAL_S: f64 = 0.01;
/// Shortest and longest interval that makes it, s.
const INTERVAL_S: (f64, f64) = (1e-5, 1.0);

/// The mean of the first intervals of an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Period {
    pub(super) mean_s: f64,
    intervals: f64,
    /// Since the last sample.
    pub(super) since_s: f64,
}

impl Default for Period {
    fn default() -> Self {
        Self { mean_s: FIRST_INTERVAL_S, intervals: 0.0, since_s: 0.0 }
    }
}

impl Period {
    /// A sample came; true when the mean is another.
    pub(super) fn sampled(&mut self) -> bool {
        let interval_s = core::mem::take(&mut self.since_s);
        if interval_s <= 0.0 || self.intervals >= INTERVALS {
            return false;
        }
        let interval_s = interval_s.clamp(INTERVAL_S.0, INTERVAL_S.1);
        self.intervals += 1.0;
        let first = if self.intervals > 1.0 { self.mean_s } else { interval_s };
        self.mean_s = first + (interval_s - first) / self.intervals;
        true
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        let mean = (INTERVAL_S.0..=INTERVAL_S.1).contains(&self.mean_s);
        let count = (0.0..=INTERVALS).contains(&self.intervals) && self.since_s >= 0.0;
        (!(mean && count)).then_some("a sampling time that no sensor has")
    }
}

impl Numbers for Period {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.mean_s.visit(visit);
        self.intervals.visit(visit);
        self.since_s.visit(visit);
    }
}
