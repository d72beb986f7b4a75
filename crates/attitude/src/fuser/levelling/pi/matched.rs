//! The integral of the specific force between the moments at which two fixes were valid.
//!
//! A receiver's velocity is late. Its change between two fixes is therefore held against the force over the interval between the
//! moments at which they were valid, not between those at which they arrived: latency and smoothing cancel, and an interval that
//! was lost does no harm.

use crate::{Complex, numbers::Numbers};

/// Intervals that are remembered.
const SLOTS: usize = 33;
/// Length of each, s, or one sample if that is longer.
const SLOT_S: f64 = 0.025;
/// Oldest velocity that the memory reaches, s.
pub(super) const AGE_MAX_S: f64 = 0.8;

/// A change of velocity and the time it took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Increment {
    /// Platform, m/s.
    pub(super) velocity_m_s: Complex<f64>,
    /// s
    pub(super) span_s: f64,
}

impl Increment {
    fn add(&mut self, other: Self) {
        self.velocity_m_s += other.velocity_m_s;
        self.span_s += other.span_s;
    }

    fn less(self, other: Self) -> Self {
        Self { velocity_m_s: self.velocity_m_s - other.velocity_m_s, span_s: self.span_s - other.span_s }
    }
}

/// Integrates the force.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matched {
    /// The latest first; that one still grows.
    recent: [Increment; SLOTS],
    /// Since the last fix was valid.
    since: Increment,
}

impl Default for Matched {
    fn default() -> Self {
        Self { recent: [Increment::default(); SLOTS], since: Increment::default() }
    }
}

impl Matched {
    /// One sample of the force in the platform.
    pub(super) fn push(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        let sample = Increment { velocity_m_s: force_m_s2 * dt_s, span_s: dt_s };
        self.since.add(sample);
        if self.recent.first().is_some_and(|slot| slot.span_s >= SLOT_S) {
            self.recent.rotate_right(1);
            self.recent[0] = Increment::default();
        }
        self.recent[0].add(sample);
    }

    /// A fix is there that was valid `age_s` ago: the increment up to then from when the one before was valid.
    pub(super) fn take(&mut self, age_s: f64) -> Increment {
        let after = self.last(age_s.clamp(0.0, AGE_MAX_S));
        let matched = self.since.less(after);
        self.since = after;
        matched
    }

    /// Time since the last fix was valid, as far as it was integrated over, s.
    pub(super) fn since_s(&self) -> f64 {
        self.since.span_s
    }

    /// The increment over the last `age_s`.
    fn last(&self, age_s: f64) -> Increment {
        let mut sum = Increment::default();
        for slot in &self.recent {
            let missing_s = age_s - sum.span_s;
            if slot.span_s > missing_s {
                let part = missing_s / slot.span_s;
                sum.add(Increment { velocity_m_s: slot.velocity_m_s * part, span_s: missing_s });
                break;
            }
            sum.add(*slot);
        }
        sum
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let negative = self.recent.iter().any(|slot| slot.span_s < 0.0);
        negative.then_some("an interval of negative length")
    }
}

impl Numbers for Matched {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for increment in self.recent.iter_mut().chain([&mut self.since]) {
            increment.velocity_m_s.visit(visit);
            increment.span_s.visit(visit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_increment_is_that_of_the_delayed_interval() {
        let mut matched = Matched::default();
        // f = t: from 0.8 to 1.3 s its integral is (1.3² − 0.8²)/2.
        for tick in 0..200 {
            matched.push(Complex::new((f64::from(tick) + 0.5) * 0.01, 0.0), 0.01);
            if tick == 99 {
                matched.take(0.2);
            }
            if tick == 149 {
                let got = matched.take(0.2);
                assert!((got.velocity_m_s.re - 0.525).abs() < 1e-3, "{got:?}");
                assert!((got.span_s - 0.5).abs() < 1e-12, "{got:?}");
            }
        }
    }

    #[test]
    fn the_oldest_velocity_is_reached_at_any_rate_of_samples() {
        for rate_hz in [5.0, 33.0, 40.0, 100.0, 1000.0] {
            let mut matched = Matched::default();
            for _ in 0..(3.0 * rate_hz) as usize {
                matched.push(Complex::new(1.0, 0.0), 1.0 / rate_hz);
            }
            assert!((matched.last(AGE_MAX_S).velocity_m_s.re - AGE_MAX_S).abs() < 1e-9, "{rate_hz} Hz");
        }
    }
}
