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

/// A fused state: w and z, rate and bias.
pub fn fused_in(frame: Frame, state: FusedState) -> FusedState {
    let (w, z_rad) = frame.point(state.w, state.z_rad);
    let [rate_rad_s, bias_rad_s] = [state.rate_rad_s, state.bias_rad_s].map(|vector| frame.body().vector(vector));
    FusedState { w, z_rad, rate_rad_s, bias_rad_s, ..state }
}
