//! Reduces a sample stream to a given rate, measured in the source's time.

use launch::TopicRate;

/// Sample selector that maintains a mean rate.
#[derive(Debug, Clone)]
pub struct Decimator {
    /// Interval between selected samples, ns; `None` to select all.
    period_ns: Option<f64>,
    due_ns: Option<f64>,
}

impl Decimator {
    /// Creates a decimator for a rate.
    pub fn new(rate: TopicRate) -> Self {
        let period_ns = match rate {
            TopicRate::All => None,
            TopicRate::Hz(hz) => Some(1e9 / hz),
        };
        Self { period_ns, due_ns: None }
    }

    /// Returns `true` if the sample at `t_ns` is selected.
    ///
    /// The selected samples have the configured mean rate if the source's rate is at least as high.
    pub fn accept(&mut self, t_ns: i64) -> bool {
        let Some(period_ns) = self.period_ns else { return true };
        let t_ns = t_ns as f64;
        // A time long before the next due time means that the source has restarted.
        let due_ns = self.due_ns.filter(|due_ns| due_ns - t_ns <= 2.0 * period_ns).unwrap_or(t_ns);
        if t_ns < due_ns {
            return false;
        }
        self.due_ns = Some(if t_ns - due_ns < period_ns { due_ns } else { t_ns } + period_ns);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(rate: TopicRate, source_hz: f64, duration_s: f64) -> usize {
        let mut decimator = Decimator::new(rate);
        let times = (0..(source_hz * duration_s) as i64).map(|i| (i as f64 * 1e9 / source_hz) as i64);
        times.filter(|t_ns| decimator.accept(*t_ns)).count()
    }

    #[test]
    fn decimator_meets_rate_for_any_source_rate() {
        for (hz, source_hz, expected) in [(50.0, 1000.0, 500), (30.0, 100.0, 300), (50.0, 33.0, 330), (7.0, 1000.0, 70)]
        {
            let kept = kept(TopicRate::Hz(hz), source_hz, 10.0);
            assert!(kept.abs_diff(expected) <= 1, "{hz} Hz of {source_hz} Hz: {kept} in 10 s");
        }
        assert_eq!(kept(TopicRate::All, 1000.0, 10.0), 10_000);
    }

    #[test]
    fn decimator_skips_gap_and_follows_source_restart() {
        let mut decimator = Decimator::new(TopicRate::Hz(10.0));
        assert!(decimator.accept(0) && decimator.accept(5_000_000_000));
        assert!(!decimator.accept(5_050_000_000) && decimator.accept(5_100_000_000));
        assert!(decimator.accept(7) && !decimator.accept(8));
    }
}
