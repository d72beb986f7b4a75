//! Detects a tilt fault, that is, a wrong level as opposed to an accelerating vehicle.
//!
//! A wrong level and an acceleration cause the same horizontal force, but differ in the norm of the
//! force. At constant velocity the norm is g, however wrong the level is. When a vehicle
//! accelerates at a rate a, the norm is √(g² + a²), in a straight line as well as in an endless
//! turn, at any speed. Innovations are therefore summed while they keep their direction. Once their
//! sum amounts to a considerable velocity, the norm of the force decides.

use crate::{Complex, GRAVITY_M_S2, scalars::scalars};

/// Velocity change at which the norm of the force is examined, m/s.
const DECISION_VELOCITY_M_S: f64 = 8.0;
/// Smallest horizontal force, divided by g, at which the level is re-initialised.
///
/// An acceleration increases the norm by an amount that grows with the square of the horizontal
/// force. Above this limit, the increase exceeds the scale error of an accelerometer. The loop
/// corrects smaller level errors by itself.
const MIN_HORIZONTAL_FORCE: f64 = 0.25;
/// Largest excess of the force's norm at which the level counts as wrong, as a fraction of the
/// excess that an acceleration would cause.
///
/// The excess is the difference between the norm and g. An acceleration a would cause the excess
/// a²/(2g), which is a²/(2g²) relative to g.
const MAX_EXCESS_FRACTION: f64 = 0.5;

/// Tilt fault detector, which sums innovations for as long as they keep their direction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TiltFaultMonitor {
    /// Time integral of the innovation divided by g, s.
    innovation_sum_s: Complex<f64>,
    /// Time integral of the horizontal part of the levelled force divided by g, s.
    force_sum_s: Complex<f64>,
    /// Time integral of |f|/g − 1, where f is the force, s.
    excess_sum_s: f64,
    duration_s: f64,
}

impl Default for TiltFaultMonitor {
    fn default() -> Self {
        let zero = Complex::new(0.0, 0.0);
        Self { innovation_sum_s: zero, force_sum_s: zero, excess_sum_s: 0.0, duration_s: 0.0 }
    }
}

impl TiltFaultMonitor {
    /// Processes an interval. `innovation` is the mean innovation, `force` the horizontal part of
    /// the levelled force and `force_norm` the norm of the whole force, all divided by g.
    ///
    /// Returns the error of the level (rad) if no acceleration explains the force.
    pub(super) fn observe(
        &mut self,
        innovation: Complex<f64>,
        force: Complex<f64>,
        force_norm: f64,
        interval_s: f64,
    ) -> Option<Complex<f64>> {
        if innovation.re * self.innovation_sum_s.re + innovation.im * self.innovation_sum_s.im < 0.0 {
            *self = Self::default();
        }
        self.innovation_sum_s += innovation * interval_s;
        self.force_sum_s += force * interval_s;
        self.excess_sum_s += (force_norm - 1.0) * interval_s;
        self.duration_s += interval_s;
        let velocity2 = self.innovation_sum_s.norm_sqr() * (GRAVITY_M_S2 * GRAVITY_M_S2);
        if velocity2 <= DECISION_VELOCITY_M_S * DECISION_VELOCITY_M_S {
            return None;
        }
        let Self { innovation_sum_s, force_sum_s, excess_sum_s, duration_s } = core::mem::take(self);
        let force2 = force_sum_s.norm_sqr() / (duration_s * duration_s);
        let is_level_wrong = force2 > MIN_HORIZONTAL_FORCE * MIN_HORIZONTAL_FORCE
            && (excess_sum_s / duration_s).abs() < 0.5 * MAX_EXCESS_FRACTION * force2.min(1.0);
        is_level_wrong.then(|| innovation_sum_s / duration_s)
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.duration_s < 0.0).then_some("a duration of tilt fault detection below zero")
    }
}

scalars!(TiltFaultMonitor: innovation_sum_s, force_sum_s, excess_sum_s, duration_s);

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_S: f64 = 0.2;

    #[test]
    fn wrong_level_is_reported_with_its_error() {
        let (mut tilt_fault, level_error_rad) = (TiltFaultMonitor::default(), Complex::new(0.3, -0.4));
        let reported = (0..10).find_map(|_| tilt_fault.observe(level_error_rad, level_error_rad, 1.0, INTERVAL_S));
        assert!(reported.is_some_and(|reported| (reported - level_error_rad).norm_sqr() < 1e-20), "{reported:?}");
    }

    #[test]
    fn lasting_acceleration_is_not_a_tilt_fault() {
        for acceleration in [0.1, 0.3, 0.8, 2.0] {
            let (mut tilt_fault, force) = (TiltFaultMonitor::default(), Complex::new(0.0, acceleration));
            let reported =
                (0..10_000).find_map(|_| tilt_fault.observe(force, force, f64::hypot(1.0, acceleration), INTERVAL_S));
            assert_eq!(reported, None, "{acceleration} g");
        }
    }

    #[test]
    fn alternating_acceleration_is_not_a_tilt_fault() {
        let mut tilt_fault = TiltFaultMonitor::default();
        for i in 0..10_000 {
            let force = Complex::new(if i / 5 % 2 == 0 { 0.7 } else { -0.7 }, 0.1);
            assert_eq!(tilt_fault.observe(force, force, 1.0, INTERVAL_S), None, "{i}");
        }
    }
}
