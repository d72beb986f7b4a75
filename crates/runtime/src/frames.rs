//! Messages in the frame of others.
//!
//! Input: messages as they are on the bus, in our frames. Output: the same in another one. Time: none. Failure: none. Applied where the attitude leaves
//! the system and nowhere before: what is on the bus, between hosts and in a flight's topics is in ours.

use attitude::{angles::Angles, frames::Frame};
use messages::{AttitudeOutput, FusedState};

/// An attitude: quaternion, angles, rate and jump. The course is clockwise from above in every frame; deviations are of no axis.
pub fn attitude_in(frame: Frame, output: AttitudeOutput) -> AttitudeOutput {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, .. } = output;
    let Angles { yaw_rad, pitch_rad, roll_rad } = frame.angles(Angles { yaw_rad, pitch_rad, roll_rad });
    AttitudeOutput {
        quaternion: frame.quaternion(output.quaternion),
        yaw_rad,
        pitch_rad,
        roll_rad,
        rate_rad_s: frame.body().vector(output.rate_rad_s),
        jump: frame.body().turn(output.jump),
        ..output
    }
}

/// An attitude of that frame in ours.
pub fn attitude_from(frame: Frame, theirs: AttitudeOutput) -> AttitudeOutput {
    let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, .. } = theirs;
    let Angles { yaw_rad, pitch_rad, roll_rad } = frame.ours_of_angles(Angles { yaw_rad, pitch_rad, roll_rad });
    let (earth, body) = (frame.earth(), frame.body());
    let [w, x, y, z] = theirs.jump;
    let [x, y, z] = body.ours([x, y, z]);
    AttitudeOutput {
        quaternion: attitude::frames::ours(earth, body, theirs.quaternion),
        yaw_rad,
        pitch_rad,
        roll_rad,
        rate_rad_s: body.ours(theirs.rate_rad_s),
        jump: [w, x, y, z],
        ..theirs
    }
}

/// A fused state: w and z, rate and bias.
pub fn fused_in(frame: Frame, state: FusedState) -> FusedState {
    let (w, z_rad) = frame.point(state.w, state.z_rad);
    let [rate_rad_s, bias_rad_s] = [state.rate_rad_s, state.bias_rad_s].map(|vector| frame.body().vector(vector));
    FusedState { w, z_rad, rate_rad_s, bias_rad_s, ..state }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attitude_that_goes_to_a_frame_and_back_is_the_same() {
        let mut ours: AttitudeOutput = bytemuck::Zeroable::zeroed();
        (ours.quaternion, ours.jump) = ([0.1, -0.5, 0.7, 0.5], [0.7, 0.5, -0.5, 0.1]);
        (ours.yaw_rad, ours.pitch_rad, ours.roll_rad) = (2.5, -0.4, 1.1);
        ours.rate_rad_s = [0.3, -0.2, 0.1];
        let numbers = |one: &AttitudeOutput| {
            let angles = [one.yaw_rad, one.pitch_rad, one.roll_rad];
            [&one.quaternion[..], &one.jump, &angles, &one.rate_rad_s].concat()
        };
        for (name, frame) in Frame::NAMES {
            let back = attitude_from(frame, attitude_in(frame, ours));
            for (there, here) in numbers(&back).into_iter().zip(numbers(&ours)) {
                assert!((there - here).abs() < 1e-15, "{name}: {back:?}");
            }
        }
    }
}
