//! Example message for benchmarks that depend on its encoded length.

use bytemuck::Zeroable as _;
use messages::{AttitudeOutput, Header};

/// Returns an attitude that has the same encoded length as one from a vehicle in motion.
pub(crate) fn attitude(header: Header) -> AttitudeOutput {
    AttitudeOutput {
        header,
        quaternion: [0.5, -0.5, 0.5, -0.5],
        yaw_rad: 2.1,
        pitch_rad: -0.1,
        roll_rad: 0.2,
        course_rad: 1.9,
        course_sd_rad: 0.03,
        rate_rad_s: [0.013, -0.2, 1.1],
        inclination_sd_rad: 0.002,
        jump: [1.0, 0.0, 0.0, 0.0],
        ..AttitudeOutput::zeroed()
    }
}
