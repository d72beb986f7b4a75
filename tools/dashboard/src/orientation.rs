//! Conversion of an attitude message for display.

use std::f64::consts::PI;

use attitude::frames::Frame;
use messages::{AttitudeOutput, CourseReference, Flags};

/// Attitude for display. Angles and rate refer to `frame`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attitude {
    /// Unit vector pointing up, in body axes right, forward, up.
    pub up: [f64; 3],
    /// Roll, pitch, yaw, °.
    pub roll_pitch_yaw_deg: [f64; 3],
    /// Standard deviation of the inclination, °; `None` if unknown.
    pub inclination_sd_deg: Option<f64>,
    /// Course, °, clockwise seen from above.
    pub course_deg: f64,
    /// Standard deviation of the course, °; `None` if unknown.
    pub course_sd_deg: Option<f64>,
    /// Reference of the course: `arb.`, `mag.` or `true`.
    pub course_reference: &'static str,
    /// Body rate, corrected by the estimated bias, °/s.
    pub rate_deg_s: [f64; 3],
    /// Name of the frame.
    pub frame: &'static str,
    /// Names of the flags that indicate a fault or a limitation.
    pub flags: Vec<&'static str>,
}

impl Attitude {
    /// Converts a message. The quaternion (w, x, y, z), the angles and the rate must refer to
    /// `frame`.
    pub fn from_output(output: &AttitudeOutput, frame: Frame) -> Self {
        let AttitudeOutput { roll_rad, pitch_rad, yaw_rad, course_rad, course_sd_rad, rate_rad_s, .. } = *output;
        let known_deg = |deviation_rad: f64| (deviation_rad < PI).then(|| deviation_rad.to_degrees());
        let course_reference = match output.course_reference {
            CourseReference::MAGNETIC => "mag.",
            CourseReference::TRUE => "true",
            _ => "arb.",
        };
        Self {
            up: up_in_body(output.quaternion, frame),
            roll_pitch_yaw_deg: [roll_rad, pitch_rad, yaw_rad].map(f64::to_degrees),
            inclination_sd_deg: known_deg(output.inclination_sd_rad),
            course_deg: course_rad.to_degrees(),
            course_sd_deg: known_deg(course_sd_rad),
            course_reference,
            rate_deg_s: rate_rad_s.map(f64::to_degrees),
            frame: frame.name(),
            flags: Flags(output.header.flags.0 & !Flags::INFORMATIONAL.0).names().collect(),
        }
    }
}

/// Returns the up direction in body axes right, forward, up. The equation is v_body = q* v_ref q,
/// with the conjugate q* of the quaternion q.
fn up_in_body([w, x, y, z]: [f64; 4], frame: Frame) -> [f64; 3] {
    let v = frame.earth().vector([0.0, 0.0, 1.0]);
    let axis = [-x, -y, -z];
    let twice = cross(axis, v).map(|part| 2.0 * part);
    let double_cross = cross(axis, twice);
    frame.body().to_native([0, 1, 2].map(|i| v[i] + w * twice[i] + double_cross[i]))
}

fn cross([a, b, c]: [f64; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

#[cfg(test)]
mod tests {
    use runtime::frames::attitude_to_frame;

    use super::*;

    #[test]
    fn up_direction_is_independent_of_message_frame() {
        // Right side down by 30°, then rotated about the vertical: in body axes, up points partly
        // to the left.
        let (sin, cos) = 15_f64.to_radians().sin_cos();
        let (sin_yaw, cos_yaw) = 40_f64.to_radians().sin_cos();
        let quaternion = [cos_yaw * cos, -sin_yaw * sin, cos_yaw * sin, sin_yaw * cos];
        let native = AttitudeOutput { quaternion, ..bytemuck::Zeroable::zeroed() };
        for (_, frame) in Frame::NAMES {
            let [right, forward, up] = Attitude::from_output(&attitude_to_frame(frame, native), frame).up;
            let error = [right + 0.5, forward, up - 0.75_f64.sqrt()].map(f64::abs);
            assert!(error.iter().all(|error| *error < 1e-12), "{frame:?}: {:?}", [right, forward, up]);
        }
    }

    #[test]
    fn informational_flags_and_unknown_sd_are_omitted() {
        let mut output: AttitudeOutput = bytemuck::Zeroable::zeroed();
        output.header.flags = Flags::AT_REST | Flags::GAP;
        (output.course_sd_rad, output.inclination_sd_rad) = (PI, 0.01);
        let attitude = Attitude::from_output(&output, Frame::EnuRfu);
        assert_eq!((attitude.flags, attitude.course_sd_deg, attitude.course_reference), (vec!["gap"], None, "arb."));
        assert!(attitude.inclination_sd_deg.is_some_and(|deg| (deg - 0.573).abs() < 1e-3));
    }
}
