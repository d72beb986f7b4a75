//! Errors of an estimated attitude against the reference.
//!
//! Input: quaternions body → earth, with the earth frame's third axis up, and yaw, pitch, roll and
//! course.
//!
//! Output: angles in degrees, and their RMSE over many samples.
//!
//! Failure: quaternions must be finite and not zero. Their length does not matter.
//!
//! Laidig et al., BROAD, *Data* 6(7):72, 2021: e = q_est q_ref*, in earth axes. Every angle uses
//! the two-argument arctangent, which is exact near 0° and near 180°, where the arc cosine is not.

use crate::{Quaternion, angles::Angles, course::GIMBAL_RAD, state::wrapped_rad};

/// Error angles of e = q_est q_ref*, each in [0, 180]. A heading offset is not removed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AttitudeError {
    /// Angle of the whole rotation, 2 acos |e_w|, in degrees.
    pub total_deg: f64,
    /// Angle of the rotation about the vertical, 2 atan |e_z / e_w|, in degrees.
    pub heading_deg: f64,
    /// Angle between the up vectors, 2 acos √(e_w² + e_z²), in degrees.
    pub inclination_deg: f64,
}

impl AttitudeError {
    /// Returns the error of `estimate` against `truth`.
    pub fn between(estimate: Quaternion<f64>, truth: Quaternion<f64>) -> Self {
        let e = estimate * truth.conjugate();
        let (tilt, upright) = (libm::hypot(e.i, e.j), libm::hypot(e.w, e.k));
        let angle_deg = |sin: f64, cos: f64| 2.0 * libm::atan2(sin, cos).to_degrees();
        Self {
            total_deg: angle_deg(libm::hypot(tilt, e.k), libm::fabs(e.w)),
            heading_deg: angle_deg(libm::fabs(e.k), libm::fabs(e.w)),
            inclination_deg: angle_deg(tilt, upright),
        }
    }

    /// Combines each angle with the same angle of `other`.
    fn zip_with(&self, other: &Self, combine: impl Fn(f64, f64) -> f64) -> Self {
        Self {
            total_deg: combine(self.total_deg, other.total_deg),
            heading_deg: combine(self.heading_deg, other.heading_deg),
            inclination_deg: combine(self.inclination_deg, other.inclination_deg),
        }
    }
}

/// Returns the signed heading error in degrees, in the interval (−180, 180], positive
/// counter-clockwise as seen from above.
///
/// The absolute value is [`AttitudeError::heading_deg`].
pub fn signed_heading_error_deg(estimate: Quaternion<f64>, truth: Quaternion<f64>) -> f64 {
    let e = estimate * truth.conjugate();
    wrapped_rad(2.0 * libm::atan2(e.k, e.w)).to_degrees()
}

/// Angles of an estimate minus those of the truth, each in (−180, 180].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleError {
    /// Roll in degrees, positive with the right side down.
    pub roll_deg: f64,
    /// Pitch in degrees, positive with the nose up.
    pub pitch_deg: f64,
    /// Yaw in degrees, positive counter-clockwise as seen from above.
    pub yaw_deg: f64,
    /// Course in degrees, positive clockwise as seen from above.
    pub course_deg: f64,
}

impl AngleError {
    /// Returns the error of an estimate, or `None` near the vertical.
    ///
    /// The result is `None` if the nose is within 1° of the vertical in the estimate or in the
    /// truth. Yaw, roll and course are meaningless there.
    pub fn between(estimate: Angles, course_rad: f64, truth: Angles) -> Option<Self> {
        let wrapped_deg = |angle_rad: f64| wrapped_rad(angle_rad).to_degrees();
        let is_vertical = [estimate, truth].iter().any(|angles| libm::fabs(angles.pitch_rad) > GIMBAL_RAD);
        (!is_vertical).then(|| Self {
            roll_deg: wrapped_deg(estimate.roll_rad - truth.roll_rad),
            pitch_deg: wrapped_deg(estimate.pitch_rad - truth.pitch_rad),
            yaw_deg: wrapped_deg(estimate.yaw_rad - truth.yaw_rad),
            // The true course is −ψ.
            course_deg: wrapped_deg(course_rad + truth.yaw_rad),
        })
    }
}

/// Error statistics over many samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Accuracy {
    count: u64,
    /// Sums of squares, degrees².
    squares: AttitudeError,
    /// Largest value of each angle.
    pub max: AttitudeError,
    /// Error of the newest sample.
    pub last: AttitudeError,
}

impl Accuracy {
    /// Adds the error of one sample.
    pub fn add(&mut self, error: AttitudeError) {
        self.count += 1;
        self.squares = self.squares.zip_with(&error, |sum, x| sum + x * x);
        self.max = self.max.zip_with(&error, f64::max);
        self.last = error;
    }

    /// Returns the number of samples.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the root mean squares, or `None` if there are no samples.
    pub fn rmse(&self) -> Option<AttitudeError> {
        let count = self.count as f64;
        (self.count > 0).then(|| self.squares.zip_with(&self.squares, |sum, _| libm::sqrt(sum / count)))
    }

    /// Returns the mean of each angle, or `None` if there are no errors.
    ///
    /// The mean is taken, for instance, over the trials of a benchmark.
    pub fn mean(errors: impl IntoIterator<Item = AttitudeError>) -> Option<AttitudeError> {
        let mut sum = AttitudeError::default();
        let mut count = 0.0;
        for error in errors {
            sum = sum.zip_with(&error, |sum, x| sum + x);
            count += 1.0;
        }
        (count > 0.0).then(|| sum.zip_with(&sum, |sum, _| sum / count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_1_SQRT_2;

    const IDENTITY: Quaternion<f64> = Quaternion::new(1.0, 0.0, 0.0, 0.0);

    fn assert_near(error: AttitudeError, [total, heading, inclination]: [f64; 3]) {
        let pairs = [(error.total_deg, total), (error.heading_deg, heading), (error.inclination_deg, inclination)];
        assert!(pairs.iter().all(|(found, expected)| (found - expected).abs() < 1e-12), "{error:?}");
    }

    #[test]
    fn known_rotations_match_hand_computed_errors() {
        let s = FRAC_1_SQRT_2;
        for (e, expected) in [
            (Quaternion::new(1.0, 0.0, 0.0, 0.0), [0.0, 0.0, 0.0]),
            (Quaternion::new(s, s, 0.0, 0.0), [90.0, 0.0, 90.0]),
            (Quaternion::new(s, 0.0, -s, 0.0), [90.0, 0.0, 90.0]),
            (Quaternion::new(s, 0.0, 0.0, s), [90.0, 90.0, 0.0]),
            (Quaternion::new(0.0, 1.0, 0.0, 0.0), [180.0, 0.0, 180.0]),
            (Quaternion::new(0.0, 0.0, 0.0, 1.0), [180.0, 180.0, 0.0]),
            // acos ½ = 60°: a third of a revolution about the space diagonal. The heading error is
            // 2 atan 1, the inclination error 2 acos √½.
            (Quaternion::new(0.5, 0.5, 0.5, 0.5), [120.0, 90.0, 90.0]),
            // A 3-4-5 triangle: the total error is 2 acos 0.8, all of it about ξ0.
            (
                Quaternion::new(0.8, 0.6, 0.0, 0.0),
                [2.0 * 0.8f64.acos().to_degrees(), 0.0, 2.0 * 0.6f64.asin().to_degrees()],
            ),
        ] {
            assert_near(AttitudeError::between(e, IDENTITY), expected);
            assert_near(AttitudeError::between(-e, IDENTITY), expected);
        }
    }

    #[test]
    fn error_is_resolved_in_earth_axes() {
        // The body lies on its side. A rotation of the estimate about the earth's vertical counts
        // as heading, regardless of the body's axes.
        let truth = Quaternion::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0);
        let about_vertical = Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);
        assert_near(AttitudeError::between(about_vertical * truth, truth), [90.0, 90.0, 0.0]);
        // A rotation by the same angle about the body's ζ axis, which is horizontal, counts as
        // inclination.
        assert_near(AttitudeError::between(truth * about_vertical, truth), [90.0, 0.0, 90.0]);
    }

    #[test]
    fn signed_heading_error_has_sign_of_yaw() {
        for turn_deg in [-170.0_f64, -30.0, 0.0, 90.0, 180.0] {
            let (sin, cos) = (0.5 * turn_deg).to_radians().sin_cos();
            let truth = Quaternion::new(0.6, 0.8, 0.0, 0.0);
            let estimate = Quaternion::new(cos, 0.0, 0.0, sin) * truth;
            for estimate in [estimate, -estimate] {
                assert!((super::signed_heading_error_deg(estimate, truth) - turn_deg).abs() < 1e-12, "{turn_deg}");
            }
        }
    }

    #[test]
    fn angle_errors_wrap_and_are_none_near_vertical() {
        let angles = |yaw_deg: f64, pitch_deg: f64, roll_deg: f64| Angles {
            yaw_rad: yaw_deg.to_radians(),
            pitch_rad: pitch_deg.to_radians(),
            roll_rad: roll_deg.to_radians(),
        };
        let (estimate, truth) = (angles(-179.0, 10.0, 170.0), angles(178.0, 12.0, -175.0));
        let error = AngleError::between(estimate, 181.0_f64.to_radians(), truth).unwrap();
        let found = [error.roll_deg, error.pitch_deg, error.yaw_deg, error.course_deg];
        assert!(found.iter().zip([-15.0, -2.0, 3.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        assert_eq!(AngleError::between(estimate, 0.0, angles(0.0, 89.5, 0.0)), None);
        assert_eq!(AngleError::between(angles(0.0, -89.5, 0.0), 0.0, truth), None);
    }

    #[test]
    fn errors_of_1e_9_deg_are_resolved() {
        let half_rad = 0.5e-9f64.to_radians();
        let error = AttitudeError::between(Quaternion::new(half_rad.cos(), 0.0, half_rad.sin(), 0.0), IDENTITY);
        assert!((error.total_deg / 1e-9 - 1.0).abs() < 1e-12, "{error:?}");
        assert!((error.inclination_deg / 1e-9 - 1.0).abs() < 1e-12, "{error:?}");
    }

    #[test]
    fn error_ignores_quaternion_length() {
        let estimate = Quaternion::new(0.9, 0.1, -0.2, 0.3);
        let truth = Quaternion::new(0.7, 0.5, 0.1, -0.4);
        let AttitudeError { total_deg, heading_deg, inclination_deg } = AttitudeError::between(estimate, truth);
        assert_near(AttitudeError::between(estimate * 1.001, truth * 7.0), [total_deg, heading_deg, inclination_deg]);
    }

    #[test]
    fn rmse_averages_samples_and_mean_averages_trials() {
        let error = |deg: f64| AttitudeError { total_deg: deg, heading_deg: 2.0 * deg, inclination_deg: 0.5 * deg };
        let mut accuracy = Accuracy::default();
        assert_eq!(accuracy.rmse(), None);
        [3.0, 4.0, 5.0, 0.0].into_iter().for_each(|deg| accuracy.add(error(deg)));
        // √((9 + 16 + 25 + 0) / 4)
        let rmse_deg = 12.5f64.sqrt();
        assert_near(accuracy.rmse().unwrap(), [rmse_deg, 2.0 * rmse_deg, 0.5 * rmse_deg]);
        assert_eq!((accuracy.count(), accuracy.max, accuracy.last), (4, error(5.0), error(0.0)));
        assert_eq!(Accuracy::mean([error(1.0), error(3.0)]), Some(error(2.0)));
        assert_eq!(Accuracy::mean([]), None);
    }
}
