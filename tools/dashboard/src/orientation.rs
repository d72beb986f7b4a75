//! From a message to the attitude that is drawn.

use std::f64::consts::PI;

use attitude::frames::Frame;
use messages::{AttitudeOutput, CourseReference, Flags};

use crate::Attitude;

impl Attitude {
    /// Of a message whose quaternion, w x y z, angles and rate are of this frame.
    pub fn of(output: &AttitudeOutput, frame: Frame) -> Self {
        let AttitudeOutput { roll_rad, pitch_rad, yaw_rad, course_rad, course_sd_rad, rate_rad_s, .. } = *output;
        let known = |deviation_rad: f64| (deviation_rad < PI).then(|| deviation_rad.to_degrees());
        let course_reference = match output.course_reference {
            CourseReference::MAGNETIC => "mag.",
            CourseReference::TRUE => "true",
            _ => "arb.",
        };
        Self {
            up: up(output.quaternion, frame),
            roll_pitch_yaw_deg: [roll_rad, pitch_rad, yaw_rad].map(f64::to_degrees),
            inclination_sd_deg: known(output.inclination_sd_rad),
            course_deg: course_rad.to_degrees(),
            course_sd_deg: known(course_sd_rad),
            course_reference,
            rate_deg_s: rate_rad_s.map(f64::to_degrees),
            frame: frame.name(),
            flags: Flags(output.header.flags.0 & !Flags::INFORMATIONAL.0).names().collect(),
        }
    }
}

/// The direction up in the body's axes right, forward, up: v_body = q* v_ref q.
fn up([w, x, y, z]: [f64; 4], frame: Frame) -> [f64; 3] {
    let v = frame.earth().vector([0.0, 0.0, 1.0]);
    let axis = [-x, -y, -z];
    let twice = cross(axis, v).map(|part| 2.0 * part);
    let more = cross(axis, twice);
    frame.body().to_native([0, 1, 2].map(|i| v[i] + w * twice[i] + more[i]))
}

fn cross([a, b, c]: [f64; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

#[cfg(test)]
mod tests {
    use runtime::frames::attitude_to_frame;

    use super::*;

    #[test]
    fn up_is_the_same_direction_in_the_body_whatever_the_frame_of_the_message() {
        // Right side down by 30°, then turned about the vertical: up leans to the left of the body.
        let (sin, cos) = 15_f64.to_radians().sin_cos();
        let (sin_yaw, cos_yaw) = 40_f64.to_radians().sin_cos();
        let quaternion = [cos_yaw * cos, -sin_yaw * sin, cos_yaw * sin, sin_yaw * cos];
        let ours = AttitudeOutput { quaternion, ..bytemuck::Zeroable::zeroed() };
        for (_, frame) in Frame::NAMES {
            let [right, forward, up] = Attitude::of(&attitude_to_frame(frame, ours), frame).up;
            let off = [right + 0.5, forward, up - 0.75_f64.sqrt()].map(f64::abs);
            assert!(off.iter().all(|off| *off < 1e-12), "{frame:?}: {:?}", [right, forward, up]);
        }
    }

    #[test]
    fn what_is_usual_is_no_flag_and_what_is_unknown_has_no_deviation() {
        let mut output: AttitudeOutput = bytemuck::Zeroable::zeroed();
        output.header.flags = Flags::AT_REST | Flags::GAP;
        (output.course_sd_rad, output.inclination_sd_rad) = (PI, 0.01);
        let drawn = Attitude::of(&output, Frame::EnuRfu);
        assert_eq!((drawn.flags, drawn.course_sd_deg, drawn.course_reference), (vec!["gap"], None, "arb."));
        assert!(drawn.inclination_sd_deg.is_some_and(|deg| (deg - 0.573).abs() < 1e-3));
    }
}
