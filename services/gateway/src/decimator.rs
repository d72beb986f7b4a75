//! So many samples of a topic a second, by the source's time.

use launch::Rate;

/// Leaves samples out so that the rate is met.
#[derive(Debug, Clone)]
pub struct Decimator {
    /// Between two samples, ns; `None` where every one is kept.
    period_ns: Option<f64>,
    due_ns: Option<f64>,
}

impl Decimator {
    /// To a rate.
    pub fn to(rate: Rate) -> Self {
        let period_ns = match rate {
            Rate::All => None,
            Rate::Hz(hz) => Some(1e9 / hz),
        };
        Self { period_ns, due_ns: None }
    }

    /// Whether the sample of this time is kept. The rate is met in the mean, whatever the source's own.
    pub fn keeps(&mut self, t_ns: i64) -> bool {
        let Some(period_ns) = self.period_ns else { return true };
        let t_ns = t_ns as f64;
        // A time far before the next one due is that of a source that began anew.
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

    fn kept(rate: Rate, source_hz: f64, duration_s: f64) -> usize {
        let mut decimator = Decimator::to(rate);
        let times = (0..(source_hz * duration_s) as i64).map(|i| (i as f64 * 1e9 / source_hz) as i64);
        times.filter(|t_ns| decimator.keeps(*t_ns)).count()
    }

    #[test]
    fn a_rate_is_met_whatever_the_source_has() {
        for (hz, source_hz, expected) in [(50.0, 1000.0, 500), (30.0, 100.0, 300), (50.0, 33.0, 330), (7.0, 1000.0, 70)]
        {
            let kept = kept(Rate::Hz(hz), source_hz, 10.0);
            assert!(kept.abs_diff(expected) <= 1, "{hz} Hz of {source_hz} Hz: {kept} in 10 s");
        }
        assert_eq!(kept(Rate::All, 1000.0, 10.0), 10_000);
    }

    #[test]
    fn after_a_gap_nothing_is_made_up_and_a_source_that_begins_anew_is_heard() {
        let mut decimator = Decimator::to(Rate::Hz(10.0));
        assert!(decimator.keeps(0) && decimator.keeps(5_000_000_000));
        assert!(!decimator.keeps(5_050_000_000) && decimator.keeps(5_100_000_000));
        assert!(decimator.keeps(7) && !decimator.keeps(8));
    }
}
