//! How far an estimated attitude is from the true one.
//!
//! Input: quaternions body → earth, the earth frame's third axis up, and the angles that people read. Output: angles in degrees, and their RMSE over
//! many. Time: none.
//! Failure: none for quaternions that are finite and not zero; their length does not matter.
//!
//! Laidig et al., BROAD, *Data* 6(7):72, 2021: e = q_est q_ref*, in earth axes. Every angle is taken by the two-argument
//! arctangent, which is exact near 0 and near 180°, where the arc cosine is not.

use crate::{Quaternion, angles::Angles, course::GIMBAL_RAD, state::wrapped_rad};

/// The angles of e = q_est q_ref*, each in [0, 180]. No heading offset is taken out.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AttitudeError {
    /// The whole turn, 2 acos |e_w|, degrees.
    pub total_deg: f64,
    /// The turn about the vertical, 2 atan |e_z / e_w|, degrees.
    pub heading_deg: f64,
    /// The angle between the up vectors, 2 acos √(e_w² + e_z²), degrees.
    pub inclination_deg: f64,
}

impl AttitudeError {
    /// How far `estimate` is from `truth`.
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

    /// Each angle by itself with that of another.
    fn with(&self, other: &Self, combine: impl Fn(f64, f64) -> f64) -> Self {
        Self {
            total_deg: combine(self.total_deg, other.total_deg),
            heading_deg: combine(self.heading_deg, other.heading_deg),
            inclination_deg: combine(self.inclination_deg, other.inclination_deg),
        }
    }
}

/// The turn about the vertical with its sign, counter-clockwise from above positive, (−180, 180], degrees; its size is
/// [`AttitudeError::heading_deg`].
pub fn turn_deg(estimate: Quaternion<f64>, truth: Quaternion<f64>) -> f64 {
    let e = estimate * truth.conjugate();
    wrapped_rad(2.0 * libm::atan2(e.k, e.w)).to_degrees()
}

/// Angles of an estimate less those of the truth, each in (−180, 180].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleError {
    /// Roll, right side down positive, degrees.
    pub roll_deg: f64,
    /// Pitch, nose up positive, degrees.
    pub pitch_deg: f64,
    /// Yaw, counter-clockwise from above positive, degrees.
    pub yaw_deg: f64,
    /// Course, clockwise from above positive, degrees.
    pub course_deg: f64,
}

impl AngleError {
    /// `None` where either nose is within 1° of the vertical: yaw, roll and course mean nothing there.
    pub fn between(estimate: Angles, course_rad: f64, truth: Angles) -> Option<Self> {
        let off_deg = |angle_rad: f64| wrapped_rad(angle_rad).to_degrees();
        let is_vertical = [estimate, truth].iter().any(|angles| libm::fabs(angles.pitch_rad) > GIMBAL_RAD);
        (!is_vertical).then(|| Self {
            roll_deg: off_deg(estimate.roll_rad - truth.roll_rad),
            pitch_deg: off_deg(estimate.pitch_rad - truth.pitch_rad),
            yaw_deg: off_deg(estimate.yaw_rad - truth.yaw_rad),
            // The true course is −ψ.
            course_deg: off_deg(course_rad + truth.yaw_rad),
        })
    }
}

/// The errors of many samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Accuracy {
    count: u64,
    /// Sums of squares, degrees².
    squares: AttitudeError,
    /// The largest of each.
    pub max: AttitudeError,
    /// The last.
    pub now: AttitudeError,
}

impl Accuracy {
    /// Takes the error of one more sample.
    pub fn add(&mut self, error: AttitudeError) {
        self.count += 1;
        self.squares = self.squares.with(&error, |sum, x| sum + x * x);
        self.max = self.max.with(&error, f64::max);
        self.now = error;
    }

    /// Samples taken.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Roots of the means of the squares; `None` without a single sample.
    pub fn rmse(&self) -> Option<AttitudeError> {
        let count = self.count as f64;
        (self.count > 0).then(|| self.squares.with(&self.squares, |sum, _| libm::sqrt(sum / count)))
    }

    /// The mean of each, as over the trials of a benchmark; `None` of nothing.
    pub fn mean(of: impl IntoIterator<Item = AttitudeError>) -> Option<AttitudeError> {
        let mut sum = AttitudeError::default();
        let mut count = 0.0;
        for error in of {
            sum = sum.with(&error, |sum, x| sum + x);
            count += 1.0;
        }
        (count > 0.0).then(|| sum.with(&sum, |sum, _| sum / count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_1_SQRT_2;

    const NONE: Quaternion<f64> = Quaternion::new(1.0, 0.0, 0.0, 0.0);

    fn assert_near(error: AttitudeError, [total, heading, inclination]: [f64; 3]) {
        let pairs = [(error.total_deg, total), (error.heading_deg, heading), (error.inclination_deg, inclination)];
        assert!(pairs.iter().all(|(found, expected)| (found - expected).abs() < 1e-12), "{error:?}");
    }

    #[test]
    fn quarter_turns_about_the_axes_are_what_a_hand_computes() {
        let s = FRAC_1_SQRT_2;
        for (e, expected) in [
            (Quaternion::new(1.0, 0.0, 0.0, 0.0), [0.0, 0.0, 0.0]),
            (Quaternion::new(s, s, 0.0, 0.0), [90.0, 0.0, 90.0]),
            (Quaternion::new(s, 0.0, -s, 0.0), [90.0, 0.0, 90.0]),
            (Quaternion::new(s, 0.0, 0.0, s), [90.0, 90.0, 0.0]),
            (Quaternion::new(0.0, 1.0, 0.0, 0.0), [180.0, 0.0, 180.0]),
            (Quaternion::new(0.0, 0.0, 0.0, 1.0), [180.0, 180.0, 0.0]),
            // acos ½ = 60°: a third of a turn about the space diagonal; heading 2 atan 1, inclination 2 acos √½.
            (Quaternion::new(0.5, 0.5, 0.5, 0.5), [120.0, 90.0, 90.0]),
            // 3-4-5: total 2 acos 0.8, all of it about ξ0.
            (
                Quaternion::new(0.8, 0.6, 0.0, 0.0),
                [2.0 * 0.8f64.acos().to_degrees(), 0.0, 2.0 * 0.6f64.asin().to_degrees()],
            ),
        ] {
            assert_near(AttitudeError::between(e, NONE), expected);
            assert_near(AttitudeError::between(-e, NONE), expected);
        }
    }

    #[test]
    fn the_error_is_taken_in_earth_axes() {
        // The body lies on its side; a turn of the estimate about the earth's vertical is heading, whatever the body's axes.
        let truth = Quaternion::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0);
        let about_vertical = Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);
        assert_near(AttitudeError::between(about_vertical * truth, truth), [90.0, 90.0, 0.0]);
        // The same turn about the body's ζ, which is horizontal, is inclination.
        assert_near(AttitudeError::between(truth * about_vertical, truth), [90.0, 0.0, 90.0]);
    }

    #[test]
    fn the_turn_about_the_vertical_has_the_sign_of_yaw() {
        for turn_deg in [-170.0_f64, -30.0, 0.0, 90.0, 180.0] {
            let (sin, cos) = (0.5 * turn_deg).to_radians().sin_cos();
            let truth = Quaternion::new(0.6, 0.8, 0.0, 0.0);
            let estimate = Quaternion::new(cos, 0.0, 0.0, sin) * truth;
            for estimate in [estimate, -estimate] {
                assert!((super::turn_deg(estimate, truth) - turn_deg).abs() < 1e-12, "{turn_deg}");
            }
        }
    }

    #[test]
    fn angles_are_held_against_each_other_the_short_way_round_and_not_at_the_vertical() {
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
    fn a_billionth_of_a_degree_is_still_seen() {
        let half_rad = 0.5e-9f64.to_radians();
        let error = AttitudeError::between(Quaternion::new(half_rad.cos(), 0.0, half_rad.sin(), 0.0), NONE);
        assert!((error.total_deg / 1e-9 - 1.0).abs() < 1e-12, "{error:?}");
        assert!((error.inclination_deg / 1e-9 - 1.0).abs() < 1e-12, "{error:?}");
    }

    #[test]
    fn the_length_of_a_quaternion_does_not_matter() {
        let estimate = Quaternion::new(0.9, 0.1, -0.2, 0.3);
        let truth = Quaternion::new(0.7, 0.5, 0.1, -0.4);
        let AttitudeError { total_deg, heading_deg, inclination_deg } = AttitudeError::between(estimate, truth);
        assert_near(AttitudeError::between(estimate * 1.001, truth * 7.0), [total_deg, heading_deg, inclination_deg]);
    }

    #[test]
    fn rmse_is_over_samples_and_the_mean_over_trials() {
        let of = |deg: f64| AttitudeError { total_deg: deg, heading_deg: 2.0 * deg, inclination_deg: 0.5 * deg };
        let mut accuracy = Accuracy::default();
        assert_eq!(accuracy.rmse(), None);
        [3.0, 4.0, 5.0, 0.0].into_iter().for_each(|deg| accuracy.add(of(deg)));
        // √((9 + 16 + 25 + 0) / 4)
        let rmse_deg = 12.5f64.sqrt();
        assert_near(accuracy.rmse().unwrap(), [rmse_deg, 2.0 * rmse_deg, 0.5 * rmse_deg]);
        assert_eq!((accuracy.count(), accuracy.max, accuracy.now), (4, of(5.0), of(0.0)));
        assert_eq!(Accuracy::mean([of(1.0), of(3.0)]), Some(of(2.0)));
        assert_eq!(Accuracy::mean([]), None);
    }
}
