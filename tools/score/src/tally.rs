//! The errors of one chain of stages over one trial.
//!
//! Input: what the chain says at a tick, and the truth. Output: root mean squares of the errors of each angle and of the gyro's bias, the drift of a
//! heading that is counted from nowhere, errors over their own deviation. Time: that of the samples. Failure: what has no truth is not counted.

use attitude::{
    Quaternion, Vector3,
    metrics::{AngleError, AttitudeError, signed_heading_error_deg},
    state::{Attitude, wrapped_rad},
};
use messages::{AttitudeOutput, CourseReference, FusedState};

use crate::{
    normalised::Deviations,
    table::{Errors, ErrorsDeg},
};

/// The truth at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Body → reference, w x y z.
    pub quaternion: [f64; 4],
    /// It counts.
    pub scored: bool,
    /// What the gyro reads too much, rad/s, body axes, where that is known.
    pub gyro_bias_rad_s: Option<[f64; 3]>,
}

/// Signed errors at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Of the whole.
    pub attitude: AttitudeError,
    /// Of the angles; `None` at the vertical.
    pub angles: Option<AngleError>,
    /// The turn about the vertical, counter-clockwise from above positive, degrees.
    pub turn_deg: f64,
    /// The heading is counted from north, and with it yaw.
    pub heading_is_known: bool,
    /// The course is.
    pub course_is_known: bool,
    /// The gyro's bias as estimated less the true one, °/s, body axes.
    pub gyro_bias_deg_s: Option<Vector3<f64>>,
}

impl Moment {
    /// Of what a chain says at a tick.
    pub fn of(output: &AttitudeOutput, fused: &FusedState, truth: &Truth) -> Self {
        let [estimate, known] = [output.quaternion, truth.quaternion].map(|[w, x, y, z]| Quaternion::new(w, x, y, z));
        let angles = Attitude::from_quaternion(known).angles();
        let [told, true_bias] = [Some(fused.bias_rad_s), truth.gyro_bias_rad_s].map(|bias| bias.map(Vector3::from));
        Self {
            attitude: AttitudeError::between(estimate, known),
            angles: AngleError::between(Attitude::from_quaternion(estimate).angles(), output.course_rad, angles),
            turn_deg: signed_heading_error_deg(estimate, known),
            heading_is_known: fused.course_reference != CourseReference::ARBITRARY,
            course_is_known: output.course_reference != CourseReference::ARBITRARY,
            gyro_bias_deg_s: told.zip(true_bias).map(|(told, known)| (told - known).map(f64::to_degrees)),
        }
    }
}

/// Sums over a trial.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    roll: Squares,
    pitch: Squares,
    yaw: Squares,
    course: Squares,
    gyro_bias: Squares,
    drift: Drift,
    deviations: Deviations,
    /// At the last tick that counts.
    heading_is_known: Option<bool>,
}

impl Tally {
    /// The heading was counted from north at the last tick that counts; `None` where none does.
    pub fn heading_is_known(&self) -> Option<bool> {
        self.heading_is_known
    }

    /// Takes a tick that counts.
    pub fn take(&mut self, moment: &Moment, output: &AttitudeOutput, fused: &FusedState) {
        let Moment { attitude, angles, turn_deg, heading_is_known, course_is_known, gyro_bias_deg_s } = moment;
        self.heading_is_known = Some(*heading_is_known);
        let deviations = &mut self.deviations;
        deviations.inclination.push(attitude.inclination_deg, fused.inclination_sd_rad.to_degrees());
        if *heading_is_known {
            deviations.heading.push(*turn_deg, fused.heading_sd_rad.to_degrees());
        } else {
            self.drift.push(output.header.t_end_ns, *turn_deg);
        }
        if let Some(angles) = angles {
            self.roll.push(angles.roll_deg);
            self.pitch.push(angles.pitch_deg);
            if *heading_is_known {
                self.yaw.push(angles.yaw_deg);
            }
            if *course_is_known {
                self.course.push(angles.course_deg);
                deviations.course.push(angles.course_deg, output.course_sd_rad.to_degrees());
            }
        }
        if let Some(bias) = gyro_bias_deg_s {
            self.gyro_bias.push(bias.norm());
        }
    }

    /// The errors, beside those of the whole attitude; where heading is known in the end, there is no drift, and else neither heading nor total.
    pub fn errors(&self, attitude: ErrorsDeg) -> Errors {
        let is_known = self.heading_is_known == Some(true);
        let drift = self.drift.told().filter(|_| !is_known);
        let of_heading = |deg: Option<f64>| deg.filter(|_| is_known);
        Errors {
            attitude: ErrorsDeg {
                total: of_heading(attitude.total),
                heading: of_heading(attitude.heading),
                inclination: attitude.inclination,
            },
            roll: self.roll.root(),
            pitch: self.pitch.root(),
            yaw: of_heading(self.yaw.root()),
            course: self.course.root(),
            gyro_bias_deg_s: self.gyro_bias.root(),
            drift_deg_min: drift.map(|(deg_min, _)| deg_min),
            drift_end_deg: drift.map(|(_, end_deg)| end_deg),
        }
    }

    /// Errors over their own deviations.
    pub fn into_deviations(self) -> Deviations {
        self.deviations
    }
}

/// A sum of squares.
#[derive(Debug, Clone, Copy, Default)]
struct Squares {
    sum: f64,
    count: u64,
}

impl Squares {
    fn push(&mut self, value: f64) {
        self.sum += value * value;
        self.count += 1;
    }

    /// Of the mean square; none of none.
    fn root(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }
}

/// A heading over time, from its first value, whole turns counted: sums for the line of least squares through it.
#[derive(Debug, Clone, Copy, Default)]
struct Drift {
    first: Option<(i64, f64)>,
    last_deg: f64,
    count: f64,
    t: f64,
    tt: f64,
    deg: f64,
    t_deg: f64,
}

impl Drift {
    fn push(&mut self, t_ns: i64, turn_deg: f64) {
        let (first_ns, first_deg) = *self.first.get_or_insert((t_ns, turn_deg));
        let t_min = t_ns.saturating_sub(first_ns) as f64 / 60e9;
        let step_deg = wrapped_rad((turn_deg - first_deg - self.last_deg).to_radians()).to_degrees();
        self.last_deg += step_deg;
        self.count += 1.0;
        self.t += t_min;
        self.tt += t_min * t_min;
        self.deg += self.last_deg;
        self.t_deg += t_min * self.last_deg;
    }

    /// Degrees per minute, and at the end; none of less than two moments.
    fn told(&self) -> Option<(f64, f64)> {
        let spread = self.count * self.tt - self.t * self.t;
        (spread > 0.0).then(|| ((self.count * self.t_deg - self.t * self.deg) / spread, self.last_deg))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    /// Of a chain whose heading is off by `signed_heading_error_deg`, its course by −`signed_heading_error_deg` more, and whose course and heading are counted from `reference`.
    fn said(t_s: i64, turn_deg: f64, reference: CourseReference) -> (AttitudeOutput, FusedState) {
        let (sin, cos) = (0.5 * turn_deg).to_radians().sin_cos();
        let mut output = AttitudeOutput {
            quaternion: [cos, 0.0, 0.0, sin],
            course_rad: (-2.0 * turn_deg).to_radians(),
            course_reference: reference,
            ..AttitudeOutput::zeroed()
        };
        output.header.t_end_ns = t_s * 1_000_000_000;
        (output, FusedState { course_reference: reference, ..FusedState::zeroed() })
    }

    fn tally(moments: impl Iterator<Item = (AttitudeOutput, FusedState)>) -> Errors {
        let truth = Truth { quaternion: [1.0, 0.0, 0.0, 0.0], scored: true, gyro_bias_rad_s: Some([0.0, 3e-3, -4e-3]) };
        let mut tally = Tally::default();
        moments.for_each(|(output, fused)| tally.take(&Moment::of(&output, &fused, &truth), &output, &fused));
        tally.errors(ErrorsDeg { total: Some(3.0), heading: Some(2.0), inclination: Some(1.0) })
    }

    #[test]
    fn the_course_counts_as_the_course_stage_tells_it() {
        let errors = tally([3.0, -3.0].into_iter().map(|deg| said(0, deg, CourseReference::TRUE)));
        assert!((errors.yaw.unwrap() - 3.0).abs() < 1e-9 && (errors.course.unwrap() - 6.0).abs() < 1e-9, "{errors:?}");
        assert!(errors.roll.unwrap() < 1e-12 && errors.pitch.unwrap() < 1e-12);
        assert!((errors.gyro_bias_deg_s.unwrap() - 5e-3_f64.to_degrees()).abs() < 1e-12);
        assert_eq!((errors.drift_deg_min, errors.drift_end_deg), (None, None));
    }

    #[test]
    fn a_heading_from_nowhere_has_a_drift_over_many_turns_and_no_offset() {
        let moments = (0..600).map(|s| said(s, 77.0 - 2.0 * s as f64, CourseReference::ARBITRARY));
        let errors = tally(moments);
        assert!((errors.drift_deg_min.unwrap() + 120.0).abs() < 1e-6, "{errors:?}");
        assert!((errors.drift_end_deg.unwrap() + 2.0 * 599.0).abs() < 1e-6, "{errors:?}");
        assert_eq!((errors.yaw, errors.course), (None, None));
        assert_eq!(errors.attitude, ErrorsDeg { inclination: Some(1.0), ..ErrorsDeg::default() });
    }

    #[test]
    fn a_heading_that_was_found_on_the_way_has_errors_and_no_drift() {
        let before = (0..10).map(|s| said(s, 50.0, CourseReference::ARBITRARY));
        let errors = tally(before.chain((10..20).map(|s| said(s, 1.0, CourseReference::TRUE))));
        assert!((errors.yaw.unwrap() - 1.0).abs() < 1e-9 && errors.drift_deg_min.is_none(), "{errors:?}");
    }
}
