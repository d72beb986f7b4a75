//! Integral of the specific force between the validity times of two fixes.
//!
//! A receiver's velocity arrives late. Its change between two fixes is therefore compared with the
//! force over the interval between their validity times, not their arrival times. The receiver's
//! latency and smoothing then have no effect. A lost force sample does no harm, because each
//! increment stores the time that it spans.

use crate::{Complex, scalars::scalars};

/// Number of recent increments that are stored.
const SLOTS: usize = 33;
/// Minimum duration of a stored increment, s. An increment ends with the sample that reaches this
/// duration.
const SLOT_S: f64 = 0.025;
/// Maximum age of a fix's velocity, s. The stored increments cover this time.
pub(super) const MAX_AGE_S: f64 = 0.8;

/// Change of velocity over a time span.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Increment {
    /// Change of velocity in platform axes, m/s.
    pub(super) velocity_m_s: Complex<f64>,
    /// Length of the time span, s.
    pub(super) span_s: f64,
}

impl Increment {
    fn add(&mut self, other: Self) {
        self.velocity_m_s += other.velocity_m_s;
        self.span_s += other.span_s;
    }

    fn minus(self, other: Self) -> Self {
        Self { velocity_m_s: self.velocity_m_s - other.velocity_m_s, span_s: self.span_s - other.span_s }
    }
}

/// Integral of the force, together with recent increments of the integral.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DelayMatchedIntegral {
    /// Recent increments, newest first. The newest one is still growing.
    recent: [Increment; SLOTS],
    /// Increment since the validity time of the last fix.
    since_fix: Increment,
}

impl Default for DelayMatchedIntegral {
    fn default() -> Self {
        Self { recent: [Increment::default(); SLOTS], since_fix: Increment::default() }
    }
}

impl DelayMatchedIntegral {
    /// Adds a sample of the force, in platform axes, to the integral.
    pub(super) fn push(&mut self, force_m_s2: Complex<f64>, dt_s: f64) {
        let sample = Increment { velocity_m_s: force_m_s2 * dt_s, span_s: dt_s };
        self.since_fix.add(sample);
        if self.recent.first().is_some_and(|slot| slot.span_s >= SLOT_S) {
            self.recent.rotate_right(1);
            self.recent[0] = Increment::default();
        }
        self.recent[0].add(sample);
    }

    /// Returns the increment between the validity times of the previous and the new fix. The new
    /// fix was valid `age_s` ago.
    pub(super) fn take_increment(&mut self, age_s: f64) -> Increment {
        let after_fix = self.over_last(age_s.clamp(0.0, MAX_AGE_S));
        let matched = self.since_fix.minus(after_fix);
        self.since_fix = after_fix;
        matched
    }

    /// Returns the total duration of the force samples since the validity time of the last fix, s.
    pub(super) fn since_fix_s(&self) -> f64 {
        self.since_fix.span_s
    }

    /// Returns the increment over the last `age_s` seconds.
    fn over_last(&self, age_s: f64) -> Increment {
        let mut sum = Increment::default();
        for slot in &self.recent {
            let missing_s = age_s - sum.span_s;
            if slot.span_s > missing_s {
                let fraction = missing_s / slot.span_s;
                sum.add(Increment { velocity_m_s: slot.velocity_m_s * fraction, span_s: missing_s });
                break;
            }
            sum.add(*slot);
        }
        sum
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let negative = self.recent.iter().any(|slot| slot.span_s < 0.0);
        negative.then_some("an interval of negative length")
    }
}

scalars!(Increment: velocity_m_s, span_s);
scalars!(DelayMatchedIntegral: recent, since_fix);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn increment_covers_the_delayed_interval() {
        let mut matched = DelayMatchedIntegral::default();
        // The force is f = t. Its integral from 0.8 to 1.3 s is (1.3² − 0.8²)/2.
        for tick in 0..200 {
            matched.push(Complex::new((f64::from(tick) + 0.5) * 0.01, 0.0), 0.01);
            if tick == 99 {
                matched.take_increment(0.2);
            }
            if tick == 149 {
                let got = matched.take_increment(0.2);
                assert!((got.velocity_m_s.re - 0.525).abs() < 1e-3, "{got:?}");
                assert!((got.span_s - 0.5).abs() < 1e-12, "{got:?}");
            }
        }
    }

    #[test]
    fn memory_reaches_max_age_at_any_sample_rate() {
        for rate_hz in [5.0, 33.0, 40.0, 100.0, 1000.0] {
            let mut matched = DelayMatchedIntegral::default();
            for _ in 0..(3.0 * rate_hz) as usize {
                matched.push(Complex::new(1.0, 0.0), 1.0 / rate_hz);
            }
            assert!((matched.over_last(MAX_AGE_S).velocity_m_s.re - MAX_AGE_S).abs() < 1e-9, "{rate_hz} Hz");
        }
    }
}
