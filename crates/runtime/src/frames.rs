//! Conversion of messages between Plumbline's frames and other axis conventions.
//!
//! - Input: messages in Plumbline's frames, as on the bus.
//! - Output: the same messages in another frame.
//!
//! The conversion is applied only where the attitude leaves the system. Messages on the bus,
//! between hosts and in recorded flights stay in Plumbline's frames.

use attitude::{angles::Angles, frames::Frame};
use messages::{AttitudeOutput, FusedState};

/// Converts the quaternion, angles, rate and jump of an attitude to `frame`.
///
/// The course and the standard deviations are unchanged: the course is clockwise from above in
/// every frame, and standard deviations have no axis.
pub fn attitude_to_frame(frame: Frame, output: AttitudeOutput) -> AttitudeOutput {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, .. } = output;
    let Angles { yaw_rad, pitch_rad, roll_rad } = frame.angles(Angles { yaw_rad, pitch_rad, roll_rad });
    AttitudeOutput {
        quaternion: frame.quaternion(output.quaternion),
        yaw_rad,
        pitch_rad,
        roll_rad,
        rate_rad_s: frame.body().vector(output.rate_rad_s),
        jump: frame.body().rotation(output.jump),
        ..output
    }
}

/// Converts an attitude from `frame` to Plumbline's frames.
pub fn attitude_from_frame(frame: Frame, other: AttitudeOutput) -> AttitudeOutput {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, .. } = other;
    let Angles { yaw_rad, pitch_rad, roll_rad } = frame.angles_to_native(Angles { yaw_rad, pitch_rad, roll_rad });
    let (earth, body) = (frame.earth(), frame.body());
    let [w, x, y, z] = other.jump;
    let [x, y, z] = body.to_native([x, y, z]);
    AttitudeOutput {
        quaternion: attitude::frames::quaternion_to_native(earth, body, other.quaternion),
        yaw_rad,
        pitch_rad,
        roll_rad,
        rate_rad_s: body.to_native(other.rate_rad_s),
        jump: [w, x, y, z],
        ..other
    }
}

/// Converts the w, z, rate and bias of a fused state to `frame`.
pub fn fused_to_frame(frame: Frame, state: FusedState) -> FusedState {
    let (w, z_rad) = frame.point(state.w, state.z_rad);
    let [rate_rad_s, bias_rad_s] = [state.rate_rad_s, state.bias_rad_s].map(|vector| frame.body().vector(vector));
    FusedState { w, z_rad, rate_rad_s, bias_rad_s, ..state }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attitude_frame_conversion_round_trips() {
        let mut native: AttitudeOutput = bytemuck::Zeroable::zeroed();
        (native.quaternion, native.jump) = ([0.1, -0.5, 0.7, 0.5], [0.7, 0.5, -0.5, 0.1]);
        (native.yaw_rad, native.pitch_rad, native.roll_rad) = (2.5, -0.4, 1.1);
        native.rate_rad_s = [0.3, -0.2, 0.1];
        let numbers = |one: &AttitudeOutput| {
            let angles = [one.yaw_rad, one.pitch_rad, one.roll_rad];
            [&one.quaternion[..], &one.jump, &angles, &one.rate_rad_s].concat()
        };
        for (name, frame) in Frame::NAMES {
            let back = attitude_from_frame(frame, attitude_to_frame(frame, native));
            for (there, here) in numbers(&back).into_iter().zip(numbers(&native)) {
                assert!((there - here).abs() < 1e-15, "{name}: {back:?}");
            }
        }
    }
}
