//! Error statistics of one chain over one trial.
//!
//! Input: the outputs of the chain at a tick, and the true attitude.
//!
//! Output: root mean square errors of the angles and the gyro bias, drift of a heading with an
//! arbitrary zero direction, and normalised errors.
//!
//! Time: sample timestamps.
//!
//! Failure: ticks without a reference are not counted.

use attitude::{
    Quaternion, Vector3,
    metrics::{AngleError, AttitudeError, signed_heading_error_deg},
    state::{Attitude, wrapped_rad},
};
use messages::{AttitudeOutput, CourseReference, FusedState};
use pipeline::compared_attitude;
use runtime::convert;

use crate::{
    normalised::RatioHistograms,
    table::{Errors, ErrorsDeg},
};

/// True state at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Attitude, body → reference, w x y z.
    pub quaternion: [f64; 4],
    /// `true` if the tick is scored.
    pub scored: bool,
    /// True gyro bias, rad/s, body axes; `None` if unknown.
    pub gyro_bias_rad_s: Option<[f64; 3]>,
}

/// Errors at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickErrors {
    /// Attitude error.
    pub attitude: AttitudeError,
    /// Signed errors of the angles; `None` if the forward axis is near the vertical.
    pub angles: Option<AngleError>,
    /// Signed heading error, degrees: rotation about the vertical from reference to estimate,
    /// positive counter-clockwise seen from above.
    pub heading_error_deg: f64,
    /// `true` if the heading, and therefore yaw, is referenced to north.
    pub heading_is_known: bool,
    /// `true` if the course is referenced to north.
    pub course_is_known: bool,
    /// Error of the estimated gyro bias, °/s, body axes; `None` if the true bias is unknown or no
    /// bias is estimated.
    pub gyro_bias_deg_s: Option<Vector3<f64>>,
}

impl TickErrors {
    /// Computes the errors of a chain's outputs at a tick.
    pub fn new(output: &AttitudeOutput, fused: &FusedState, truth: &Truth) -> Self {
        let estimate = compared_attitude(output);
        let [w, x, y, z] = truth.quaternion;
        let reference = Quaternion::new(w, x, y, z);
        let angles = Attitude::from_quaternion(reference).angles();
        let [estimated_bias, true_bias] =
            [convert::finite_vector(fused.bias_rad_s), truth.gyro_bias_rad_s.map(Vector3::from)];
        Self {
            attitude: AttitudeError::between(estimate, reference),
            angles: AngleError::between(Attitude::from_quaternion(estimate).angles(), output.course_rad, angles),
            heading_error_deg: signed_heading_error_deg(estimate, reference),
            heading_is_known: fused.course_reference != CourseReference::ARBITRARY,
            course_is_known: output.course_reference != CourseReference::ARBITRARY,
            gyro_bias_deg_s: estimated_bias
                .zip(true_bias)
                .map(|(estimate, truth)| (estimate - truth).map(f64::to_degrees)),
        }
    }
}

/// Error sums over a trial.
#[derive(Debug, Clone, Default)]
pub struct ErrorStats {
    roll: SquareSum,
    pitch: SquareSum,
    yaw: SquareSum,
    course: SquareSum,
    gyro_bias: SquareSum,
    drift: DriftFit,
    heading: CircularMean,
    ratios: RatioHistograms,
    /// `true` if the heading was known at the last scored tick; `None` before the first scored
    /// tick.
    heading_is_known: Option<bool>,
}

impl ErrorStats {
    /// Returns `true` if the heading was known at the last scored tick; `None` if no tick was
    /// scored.
    pub fn heading_is_known(&self) -> Option<bool> {
        self.heading_is_known
    }

    /// Returns the mean heading error in degrees if the error is nearly constant and not small. The
    /// error is positive counter-clockwise seen from above.
    pub fn constant_heading_error_deg(&self) -> Option<f64> {
        self.heading.constant_deg().filter(|_| self.heading_is_known == Some(true))
    }

    /// Adds a scored tick.
    pub fn update(&mut self, errors: &TickErrors, output: &AttitudeOutput, fused: &FusedState) {
        let TickErrors { attitude, angles, heading_error_deg, heading_is_known, course_is_known, gyro_bias_deg_s } =
            errors;
        self.heading_is_known = Some(*heading_is_known);
        let ratios = &mut self.ratios;
        ratios.inclination.push(attitude.inclination_deg, fused.inclination_sd_rad.to_degrees());
        if *heading_is_known {
            ratios.heading.push(*heading_error_deg, fused.heading_sd_rad.to_degrees());
            self.heading.push(*heading_error_deg);
        } else {
            self.drift.push(output.header.t_end_ns, *heading_error_deg);
        }
        if let Some(angles) = angles {
            self.roll.push(angles.roll_deg);
            self.pitch.push(angles.pitch_deg);
            if *heading_is_known {
                self.yaw.push(angles.yaw_deg);
            }
            if *course_is_known {
                self.course.push(angles.course_deg);
                ratios.course.push(angles.course_deg, output.course_sd_rad.to_degrees());
            }
        }
        if let Some(bias) = gyro_bias_deg_s {
            self.gyro_bias.push(bias.norm());
        }
    }

    /// Returns the errors over the trial. `attitude` contains the root mean square attitude errors.
    ///
    /// If the heading is known at the end, the drift is `None`. Otherwise, the heading, total and
    /// yaw errors are `None`.
    pub fn errors(&self, attitude: ErrorsDeg) -> Errors {
        let is_known = self.heading_is_known == Some(true);
        let drift = self.drift.result().filter(|_| !is_known);
        let if_known = |deg: Option<f64>| deg.filter(|_| is_known);
        Errors {
            attitude: ErrorsDeg {
                total: if_known(attitude.total),
                heading: if_known(attitude.heading),
                inclination: attitude.inclination,
            },
            roll: self.roll.rms(),
            pitch: self.pitch.rms(),
            yaw: if_known(self.yaw.rms()),
            course: self.course.rms(),
            gyro_bias_deg_s: self.gyro_bias.rms(),
            drift_deg_min: drift.map(|(deg_min, _)| deg_min),
            drift_end_deg: drift.map(|(_, end_deg)| end_deg),
        }
    }

    /// Returns the histograms of the normalised errors.
    pub fn into_ratios(self) -> RatioHistograms {
        self.ratios
    }
}

/// Sum of squares.
#[derive(Debug, Clone, Copy, Default)]
struct SquareSum {
    sum: f64,
    count: u64,
}

impl SquareSum {
    fn push(&mut self, value: f64) {
        self.sum += value * value;
        self.count += 1;
    }

    /// Returns the root mean square; `None` if there are no values.
    fn rms(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }
}

/// Mean of angles.
#[derive(Debug, Clone, Copy, Default)]
struct CircularMean {
    sin: f64,
    cos: f64,
    count: u64,
}

impl CircularMean {
    /// Minimum number of angles for which a mean is reported.
    const MIN_COUNT: u64 = 50;
    /// Smallest mean that counts as a heading offset, degrees. Ordinary heading errors are smaller.
    const MIN_OFFSET_DEG: f64 = 5.0;
    /// Smallest ratio of the mean to the standard deviation at which an error counts as constant.
    const MIN_RATIO: f64 = 3.0;

    fn push(&mut self, deg: f64) {
        let (sin, cos) = deg.to_radians().sin_cos();
        (self.sin, self.cos, self.count) = (self.sin + sin, self.cos + cos, self.count + 1);
    }

    /// Returns the mean, in degrees, if the angles have a constant offset: their mean is large and
    /// they vary little.
    fn constant_deg(&self) -> Option<f64> {
        let mean_deg = self.sin.atan2(self.cos).to_degrees();
        let length = self.sin.hypot(self.cos) / self.count as f64;
        let sd_deg = (-2.0 * length.min(1.0).ln()).sqrt().to_degrees();
        let is_offset = mean_deg.abs() > Self::MIN_OFFSET_DEG.max(Self::MIN_RATIO * sd_deg);
        (self.count >= Self::MIN_COUNT && is_offset).then_some(mean_deg)
    }
}

/// Least-squares line fitted to the heading error over time. The heading has an arbitrary zero
/// direction. The error is unwrapped and relative to its first value.
#[derive(Debug, Clone, Copy, Default)]
struct DriftFit {
    first: Option<(i64, f64)>,
    last_deg: f64,
    count: f64,
    t: f64,
    tt: f64,
    deg: f64,
    t_deg: f64,
}

impl DriftFit {
    fn push(&mut self, t_ns: i64, heading_error_deg: f64) {
        let (first_ns, first_deg) = *self.first.get_or_insert((t_ns, heading_error_deg));
        let t_min = t_ns.saturating_sub(first_ns) as f64 / 60e9;
        let step_deg = wrapped_rad((heading_error_deg - first_deg - self.last_deg).to_radians()).to_degrees();
        self.last_deg += step_deg;
        self.count += 1.0;
        self.t += t_min;
        self.tt += t_min * t_min;
        self.deg += self.last_deg;
        self.t_deg += t_min * self.last_deg;
    }

    /// Returns the drift rate in °/min and the drift at the end in degrees; `None` for fewer than
    /// two different times.
    fn result(&self) -> Option<(f64, f64)> {
        let time_variance = self.count * self.tt - self.t * self.t;
        (time_variance > 0.0).then(|| ((self.count * self.t_deg - self.t * self.deg) / time_variance, self.last_deg))
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    /// Returns outputs with heading error `heading_error_deg` and a course error twice as large.
    /// `reference` is the zero direction of heading and course.
    fn outputs(t_s: i64, heading_error_deg: f64, reference: CourseReference) -> (AttitudeOutput, FusedState) {
        let (sin, cos) = (0.5 * heading_error_deg).to_radians().sin_cos();
        let mut output = AttitudeOutput {
            quaternion: [cos, 0.0, 0.0, sin],
            course_rad: (-2.0 * heading_error_deg).to_radians(),
            course_reference: reference,
            ..AttitudeOutput::zeroed()
        };
        output.header.t_end_ns = t_s * 1_000_000_000;
        (output, FusedState { course_reference: reference, ..FusedState::zeroed() })
    }

    fn errors_of(outputs: impl Iterator<Item = (AttitudeOutput, FusedState)>) -> Errors {
        let truth = Truth { quaternion: [1.0, 0.0, 0.0, 0.0], scored: true, gyro_bias_rad_s: Some([0.0, 3e-3, -4e-3]) };
        let mut stats = ErrorStats::default();
        outputs.for_each(|(output, fused)| stats.update(&TickErrors::new(&output, &fused, &truth), &output, &fused));
        stats.errors(ErrorsDeg { total: Some(3.0), heading: Some(2.0), inclination: Some(1.0) })
    }

    #[test]
    fn course_error_uses_course_stage_output() {
        let errors = errors_of([3.0, -3.0].into_iter().map(|deg| outputs(0, deg, CourseReference::TRUE)));
        assert!((errors.yaw.unwrap() - 3.0).abs() < 1e-9 && (errors.course.unwrap() - 6.0).abs() < 1e-9, "{errors:?}");
        assert!(errors.roll.unwrap() < 1e-12 && errors.pitch.unwrap() < 1e-12);
        assert!((errors.gyro_bias_deg_s.unwrap() - 5e-3_f64.to_degrees()).abs() < 1e-12);
        assert_eq!((errors.drift_deg_min, errors.drift_end_deg), (None, None));
    }

    #[test]
    fn arbitrary_heading_has_unwrapped_drift_and_no_offset() {
        let ticks = (0..600).map(|s| outputs(s, 77.0 - 2.0 * s as f64, CourseReference::ARBITRARY));
        let errors = errors_of(ticks);
        assert!((errors.drift_deg_min.unwrap() + 120.0).abs() < 1e-6, "{errors:?}");
        assert!((errors.drift_end_deg.unwrap() + 2.0 * 599.0).abs() < 1e-6, "{errors:?}");
        assert_eq!((errors.yaw, errors.course), (None, None));
        assert_eq!(errors.attitude, ErrorsDeg { inclination: Some(1.0), ..ErrorsDeg::default() });
    }

    #[test]
    fn constant_heading_error_is_told_from_scatter() {
        let constant = |errors: &[f64]| {
            let mut mean = CircularMean::default();
            (0..100).for_each(|n| mean.push(errors[n % errors.len()]));
            mean.constant_deg()
        };
        assert!(constant(&[11.0, 13.0]).is_some_and(|deg| (deg - 12.0).abs() < 1e-9));
        assert!(constant(&[179.0, -179.0]).is_some_and(|deg| (deg.abs() - 180.0).abs() < 1e-9));
        assert_eq!([constant(&[3.0, 4.0]), constant(&[40.0, -20.0, 0.0])], [None, None]);
    }

    #[test]
    fn heading_known_at_end_has_errors_and_no_drift() {
        let before = (0..10).map(|s| outputs(s, 50.0, CourseReference::ARBITRARY));
        let errors = errors_of(before.chain((10..20).map(|s| outputs(s, 1.0, CourseReference::TRUE))));
        assert!((errors.yaw.unwrap() - 1.0).abs() < 1e-9 && errors.drift_deg_min.is_none(), "{errors:?}");
    }
}
