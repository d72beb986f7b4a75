//! Detects that the gyro heading drifts faster than the heading filter considers possible.
//!
//! Input: the mean magnetic fields of intervals before the first rest, in reference axes.
//!
//! Output: `true` once the field has turned steadily in reference axes.
//!
//! Time: the intervals.
//!
//! Failure: a drift is not detected while the body keeps its heading. The field may then also be
//! that of a strong magnet on a body that turns steadily.
//!
//! A large drift turns the field out of the gates of the heading filter within seconds. The filter
//! then rejects the field, and the drift remains unknown. This module has no gate. It follows the
//! direction of the field and the rate at which it turns. The field is compared with two models: it
//! turns steadily in reference axes, or it is fixed to the body.
//!
//! The field must have turned by half a turn. If a rate of five standard deviations were enough,
//! the effect of a hard iron of 15 µT on a body that turns slowly would be mistaken for a drift.
//!
//! On Nexus 5 with a bias of 10 °/s about one axis of the sensor, all 30 runs find the bias within
//! 60 s. Without this module, 28 runs do. With a bias of 5.5 °/s, the numbers are 29 and 24. Half a
//! turn at 3 °/s takes 60 s, so a bias of this size is found later.

use core::f64::consts::PI;

use super::{field_averager::IntervalMeans, filter::DRIFT_SD_RAD_S};
use crate::{Vector3, fuser::wz::wide_bias::UNKNOWN_BIAS_SD_RAD_S, scalars::scalars, state::wrapped_rad};

/// Smallest rate that is detected, rad/s. The heading filter finds a smaller one.
const MIN_RATE_RAD_S: f64 = 5.0 * DRIFT_SD_RAD_S;
/// Smallest angle by which the field has turned, rad. A field fixed to the body that is weaker than
/// the horizontal field cannot turn the sum of both by a larger angle.
const MIN_TURN_RAD: f64 = PI;
/// Random walk of the rate, rad/s/√s. It allows for the bias of a body that tilts.
const RATE_WALK_RAD_S: f64 = 4.5e-3;
/// Averaging time of the deviations, s.
const MEMORY_S: f64 = 10.0;
/// Largest mean square deviation from a steadily turning field, as a fraction of that from a field
/// fixed to the body.
const MAX_DEVIATION_FRACTION: f64 = 0.25;
/// Smallest strength of the horizontal field, µT. A weaker field counts as one of this strength.
const MIN_HORIZONTAL_UT: f64 = 1.0;

/// Kalman filter of the field's direction and rate, and the evidence for the two models.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct DriftMonitor {
    direction_rad: f64,
    rate_rad_s: f64,
    direction_variance_rad2: f64,
    covariance_rad2_s: f64,
    rate_variance_rad2_s2: f64,
    /// Angle by which the field has turned in one direction, rad; zero while the rate is below
    /// [`MIN_RATE_RAD_S`].
    turn_rad: f64,
    /// Mean strength of the horizontal field, µT.
    horizontal_ut: f64,
    /// Mean field in body axes, µT.
    body_field_ut: Vector3<f64>,
    /// Mean square deviation of the horizontal field from a steadily turning field, relative to its
    /// strength.
    turning_deviation2: f64,
    /// Mean square deviation of the field from a field fixed to the body, relative to the strength
    /// of the horizontal field.
    fixed_deviation2: f64,
    /// Time since the start, s. It is limited to [`MEMORY_S`].
    age_s: f64,
}

impl DriftMonitor {
    /// Processes the field of an interval. `noise_ut2_s` is the spectral density of its noise.
    ///
    /// Returns `true` if the field has turned steadily.
    pub(super) fn observe(&mut self, interval: &IntervalMeans, noise_ut2_s: f64) -> bool {
        let IntervalMeans { field_ut, axes, duration_s, .. } = *interval;
        let direction_rad = libm::atan2(field_ut[1], field_ut[0]);
        let horizontal_ut = libm::hypot(field_ut[0], field_ut[1]).max(MIN_HORIZONTAL_UT);
        let body_field_ut = axes.iter().zip(field_ut).map(|(axis, part_ut)| Vector3::from(*axis) * part_ut).sum();
        if self.age_s == 0.0 {
            *self = Self {
                direction_rad,
                direction_variance_rad2: PI * PI,
                rate_variance_rad2_s2: UNKNOWN_BIAS_SD_RAD_S * UNKNOWN_BIAS_SD_RAD_S,
                horizontal_ut,
                body_field_ut,
                ..Self::default()
            };
        }
        let innovation_rad = self.follow(direction_rad, noise_ut2_s / (horizontal_ut * horizontal_ut), duration_s);
        let mean_ut = self.horizontal_ut.max(MIN_HORIZONTAL_UT);
        self.age_s = (self.age_s + duration_s).min(MEMORY_S);
        let gain = duration_s / self.age_s;
        let (change_ut, body_change_ut) = (horizontal_ut - self.horizontal_ut, body_field_ut - self.body_field_ut);
        let turning2 = innovation_rad * innovation_rad + change_ut * change_ut / (mean_ut * mean_ut);
        let fixed2 = body_change_ut.norm_squared() / (mean_ut * mean_ut);
        self.turning_deviation2 += (turning2 - self.turning_deviation2) * gain;
        self.fixed_deviation2 += (fixed2 - self.fixed_deviation2) * gain;
        self.horizontal_ut += change_ut * gain;
        self.body_field_ut += body_change_ut * gain;
        let turn_rad = self.rate_rad_s * duration_s;
        let is_steady = libm::fabs(self.rate_rad_s) > MIN_RATE_RAD_S && self.turn_rad * turn_rad >= 0.0;
        self.turn_rad = if is_steady { self.turn_rad + turn_rad } else { 0.0 };
        libm::fabs(self.turn_rad) > MIN_TURN_RAD
            && self.turning_deviation2 < MAX_DEVIATION_FRACTION * self.fixed_deviation2
    }

    /// Updates direction and rate with a measured direction and returns the innovation, rad.
    ///
    /// `noise_rad2_s` is the spectral density of the measurement's noise.
    fn follow(&mut self, direction_rad: f64, noise_rad2_s: f64, duration_s: f64) -> f64 {
        let predicted_rad = self.direction_rad + self.rate_rad_s * duration_s;
        self.direction_variance_rad2 +=
            (2.0 * self.covariance_rad2_s + self.rate_variance_rad2_s2 * duration_s) * duration_s;
        self.covariance_rad2_s += self.rate_variance_rad2_s2 * duration_s;
        self.rate_variance_rad2_s2 += RATE_WALK_RAD_S * RATE_WALK_RAD_S * duration_s;
        let innovation_rad = wrapped_rad(direction_rad - predicted_rad);
        let variance_rad2 = self.direction_variance_rad2 + noise_rad2_s / duration_s;
        let (gain, rate_gain) = (self.direction_variance_rad2 / variance_rad2, self.covariance_rad2_s / variance_rad2);
        self.direction_rad = wrapped_rad(predicted_rad + gain * innovation_rad);
        self.rate_rad_s += rate_gain * innovation_rad;
        self.rate_variance_rad2_s2 -= rate_gain * self.covariance_rad2_s;
        self.covariance_rad2_s -= gain * self.covariance_rad2_s;
        self.direction_variance_rad2 -= gain * self.direction_variance_rad2;
        innovation_rad
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { direction_variance_rad2, rate_variance_rad2_s2, age_s, .. } = *self;
        let negative = [direction_variance_rad2, rate_variance_rad2_s2, age_s].iter().any(|value| *value < 0.0);
        negative.then_some("a variance or time of the drift monitor below zero")
    }
}

scalars!(DriftMonitor:
    direction_rad, rate_rad_s, direction_variance_rad2, covariance_rad2_s, rate_variance_rad2_s2, turn_rad, horizontal_ut,
    body_field_ut, turning_deviation2, fixed_deviation2, age_s
);

#[cfg(test)]
mod tests {
    use super::*;

    const FIELD_UT: [f64; 3] = [4.0, 18.0, -42.0];
    const NOISE_UT2_S: f64 = 60.0;

    /// Returns the time (s) at which a drift is detected, or `None` if none is detected within 2
    /// min.
    ///
    /// The functions of the time (s) return the true heading and the heading of the gyro (rad).
    /// `magnet_ut` is fixed to the body.
    fn detected_s(
        heading_rad: impl Fn(f64) -> f64,
        gyro_heading_rad: impl Fn(f64) -> f64,
        magnet_ut: Vector3<f64>,
    ) -> Option<f64> {
        let about_vertical = |angle_rad| nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), angle_rad);
        let mut monitor = DriftMonitor::default();
        (1..600).map(|i| 0.2 * f64::from(i)).find(|t_s| {
            let body_field_ut = about_vertical(-heading_rad(*t_s)) * Vector3::from(FIELD_UT) + magnet_ut;
            let to_reference = about_vertical(gyro_heading_rad(*t_s));
            let interval = IntervalMeans {
                field_ut: (to_reference * body_field_ut).into(),
                axes: to_reference.matrix().transpose().into(),
                duration_s: 0.2,
                ..IntervalMeans::default()
            };
            monitor.observe(&interval, NOISE_UT2_S)
        })
    }

    #[test]
    fn drift_of_turning_body_is_detected_after_half_a_turn() {
        for rate_rad_s in [3.0, -5.5, 10.0, -10.0].map(f64::to_radians) {
            let heading_rad = |t_s: f64| libm::sin(0.5 * t_s);
            let detected_s = detected_s(heading_rad, |t_s| heading_rad(t_s) + rate_rad_s * t_s, Vector3::zeros());
            let max_s = PI / libm::fabs(rate_rad_s) + 10.0;
            assert!(detected_s.is_some_and(|t_s| t_s <= max_s), "{rate_rad_s} rad/s: {detected_s:?}");
        }
    }

    #[test]
    fn magnet_on_steadily_turning_body_is_no_drift() {
        for magnet_ut in [15.0, 30.0, 60.0, 200.0, 400.0] {
            let heading_rad = |t_s: f64| 0.2 * t_s;
            assert_eq!(detected_s(heading_rad, heading_rad, Vector3::x() * magnet_ut), None, "{magnet_ut} µT");
        }
    }
}
