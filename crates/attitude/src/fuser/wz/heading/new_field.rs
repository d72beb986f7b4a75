//! Detects a steady magnetic field that differs from the one on which the heading relies.
//!
//! Input: the fields that the main hypothesis has rejected while the body turned, in reference
//! axes.
//!
//! Output: the mean of these fields and the time for which they have been steady.
//!
//! Time: the intervals in which the body turned.
//!
//! Failure: a magnet may stay near the body for longer than the earth's field was used. The field
//! of the magnet is then mistaken for the earth's field.
//!
//! A field that is steady in reference axes while the body turns is not fixed to the body. Fields
//! of passing magnets are not steady.

use crate::scalars::scalars;

/// Averaging time of the magnetic field, s. It lets the mean follow the drift of the gyro heading.
const AVERAGING_S: f64 = 10.0;
/// Largest distance from the mean at which a magnetic field counts as steady, µT.
///
/// The distance is about two standard deviations of the local disturbance on three axes.
const MAX_DISTANCE_UT: f64 = 5.0;
/// Rate at which the counted steady time decreases while the magnetic field is not steady.
const DECREASE_PER_S: f64 = 2.0;
/// Longest steady time that is counted, s.
const MAX_STEADY_S: f64 = 120.0;

/// Mean of the magnetic fields that the main hypothesis has rejected.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct NewField {
    mean_ut: [f64; 3],
    steady_s: f64,
}

impl NewField {
    /// Processes a magnetic field that the main hypothesis has rejected, in reference axes, µT.
    pub(super) fn observe_rejected(&mut self, field_ut: [f64; 3], interval_s: f64) {
        if self.steady_s == 0.0 {
            self.mean_ut = field_ut;
        }
        let distance2_ut2: f64 = field_ut.iter().zip(self.mean_ut).map(|(a, b)| (a - b) * (a - b)).sum();
        if distance2_ut2 > MAX_DISTANCE_UT * MAX_DISTANCE_UT {
            self.observe_other(interval_s);
            return;
        }
        self.steady_s = (self.steady_s + interval_s).min(MAX_STEADY_S);
        let gain = interval_s / self.steady_s.min(AVERAGING_S);
        self.mean_ut.iter_mut().zip(field_ut).for_each(|(mean, field)| *mean += (field - *mean) * gain);
    }

    /// Processes an interval in which the magnetic field was accepted or differed from the mean.
    pub(super) fn observe_other(&mut self, interval_s: f64) {
        self.steady_s = (self.steady_s - DECREASE_PER_S * interval_s).max(0.0);
    }

    /// Returns the time for which the rejected magnetic field has been steady while the body
    /// turned, s.
    pub(super) fn steady_s(&self) -> f64 {
        self.steady_s
    }

    /// Returns the mean of the rejected magnetic fields in reference axes, µT.
    pub(super) fn mean_ut(&self) -> [f64; 3] {
        self.mean_ut
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (!(0.0..=MAX_STEADY_S).contains(&self.steady_s)).then_some("a duration of a new field out of range")
    }
}

scalars!(NewField: mean_ut, steady_s);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_field_is_counted_and_passing_magnets_are_not() {
        let mut new_field = NewField::default();
        (0..50).for_each(|_| new_field.observe_rejected([20.0, 5.0, -40.0], 0.2));
        assert!((new_field.steady_s() - 10.0).abs() < 1e-9 && (new_field.mean_ut()[0] - 20.0).abs() < 1e-9);
        let mut passing = NewField::default();
        (0..50).for_each(|i| passing.observe_rejected([20.0 + 3.0 * f64::from(i), 5.0, -40.0], 0.2));
        assert!(passing.steady_s() < 1.0, "{}", passing.steady_s());
    }
}
