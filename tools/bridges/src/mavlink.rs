//! MAVLink 2 messages: HEARTBEAT, ATTITUDE_QUATERNION (31) and ATTITUDE (30).
//!
//! - Input: attitudes in the native frame that passed the check in [`validity`](crate::validity).
//! - Output: encoded frames. Quaternion, angles and rates have single precision. Body axes are
//!   forward, right, down; earth axes are north, east, down.
//! - Time: `time_boot_ms` is the end of the sample's interval on the source's clock, ms modulo 2³².
//!   ATTITUDE_QUATERNION and ATTITUDE of the same sample have the same value.

use attitude::frames::Frame;
use mavlink::{
    MAVLinkV2MessageRaw, MavHeader, MessageData,
    dialects::ardupilotmega::{
        ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, HEARTBEAT_DATA, MavAutopilot, MavModeFlag, MavState, MavType,
    },
};
use messages::AttitudeOutput;
use runtime::frames::attitude_to_frame;

/// `MAV_COMP_ID_AUTOPILOT1`: the component that a ground station shows as the vehicle.
pub const AUTOPILOT_COMPONENT_ID: u8 = 1;
/// Version of the message definitions (common.xml).
const MAVLINK_VERSION: u8 = 3;

/// Encodes the messages of one MAVLink component, with consecutive sequence numbers.
#[derive(Debug)]
pub struct MavlinkEncoder {
    header: MavHeader,
}

/// System status reported by HEARTBEAT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeartbeatStatus {
    /// No attitude has been sent yet.
    Starting,
    /// Attitudes are being sent.
    Active,
    /// Attitudes were sent, but not recently.
    Silent,
}

/// MAVLink messages with the attitude of one tick.
#[derive(Debug, Clone, PartialEq)]
pub struct AttitudeMessages {
    /// Attitude as a quaternion, w first.
    pub quaternion: ATTITUDE_QUATERNION_DATA,
    /// Attitude as Euler angles.
    pub angles: ATTITUDE_DATA,
}

impl MavlinkEncoder {
    /// Creates an encoder for a component of a system. Both identifiers must be from 1 to 255.
    pub fn new(system_id: u8, component_id: u8) -> Self {
        Self { header: MavHeader { system_id: system_id.into(), component_id, sequence: 0 } }
    }

    /// Encodes a heartbeat.
    ///
    /// The component [`AUTOPILOT_COMPONENT_ID`] is reported as a generic autopilot, any other one
    /// as a companion computer.
    pub fn heartbeat(&mut self, status: HeartbeatStatus) -> MAVLinkV2MessageRaw {
        let (mavtype, autopilot) = match self.header.component_id {
            AUTOPILOT_COMPONENT_ID => (MavType::MAV_TYPE_GENERIC, MavAutopilot::MAV_AUTOPILOT_GENERIC),
            _ => (MavType::MAV_TYPE_ONBOARD_CONTROLLER, MavAutopilot::MAV_AUTOPILOT_INVALID),
        };
        let system_status = match status {
            HeartbeatStatus::Starting => MavState::MAV_STATE_BOOT,
            HeartbeatStatus::Active => MavState::MAV_STATE_ACTIVE,
            HeartbeatStatus::Silent => MavState::MAV_STATE_CRITICAL,
        };
        let base_mode = MavModeFlag::empty();
        let mavlink_version = MAVLINK_VERSION;
        self.encode(&HEARTBEAT_DATA { custom_mode: 0, mavtype, autopilot, base_mode, system_status, mavlink_version })
    }

    /// Encodes a message with the next sequence number.
    pub fn encode(&mut self, message: &impl MessageData) -> MAVLinkV2MessageRaw {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message_data(self.header, message);
        self.header.sequence = self.header.sequence.wrapping_add(1);
        raw
    }
}

/// Converts an attitude to MAVLink messages.
pub fn attitude_messages(output: &AttitudeOutput) -> AttitudeMessages {
    let AttitudeOutput { header, quaternion, yaw_rad, pitch_rad, roll_rad, rate_rad_s, .. } =
        attitude_to_frame(Frame::NedFrd, *output);
    let time_boot_ms = header.t_end_ns.div_euclid(1_000_000) as u32;
    let [q1, q2, q3, q4] = quaternion.map(|part| part as f32);
    let [rollspeed, pitchspeed, yawspeed] = rate_rad_s.map(|part| part as f32);
    let [roll, pitch, yaw] = [roll_rad, pitch_rad, yaw_rad].map(|angle| angle as f32);
    AttitudeMessages {
        quaternion: ATTITUDE_QUATERNION_DATA {
            time_boot_ms,
            q1,
            q2,
            q3,
            q4,
            rollspeed,
            pitchspeed,
            yawspeed,
            // All zeros mean that no rotation for display is specified (common.xml).
            repr_offset_q: [0.0; 4],
        },
        angles: ATTITUDE_DATA { time_boot_ms, roll, pitch, yaw, rollspeed, pitchspeed, yawspeed },
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_6;

    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn eastward_climb_is_in_ned_and_frd() {
        let (s, c) = (FRAC_PI_6 / 2.0).sin_cos();
        let h = 0.5f64.sqrt();
        // Native frame: 90° clockwise seen from above, then nose up by 30° about the right axis.
        let quaternion = [h * c, h * s, -h * s, -h * c];
        let output = AttitudeOutput {
            quaternion,
            yaw_rad: -std::f64::consts::FRAC_PI_2,
            pitch_rad: FRAC_PI_6,
            rate_rad_s: [0.1, 0.2, 0.3],
            ..Zeroable::zeroed()
        };
        let AttitudeMessages { quaternion: q, angles: a } = attitude_messages(&output);
        let is_close = |found: [f32; 4], expected: [f64; 4]| {
            found.iter().zip(expected).all(|(found, wanted)| (f64::from(*found) - wanted).abs() < 1e-7)
        };
        // Rotation about down by 90°, then about right by 30°: qz(90°) qy(30°).
        assert!(is_close([q.q1, q.q2, q.q3, q.q4], [h * c, -h * s, h * s, h * c]), "{q:?}");
        assert!(is_close([a.roll, a.pitch, a.yaw, 0.0], [0.0, FRAC_PI_6, std::f64::consts::FRAC_PI_2, 0.0]), "{a:?}");
        assert!(is_close([a.rollspeed, a.pitchspeed, a.yawspeed, 0.0], [0.2, 0.1, -0.3, 0.0]), "{a:?}");
    }

    #[test]
    fn messages_are_numbered_and_companion_is_not_autopilot() {
        let mut encoder = MavlinkEncoder::new(7, AUTOPILOT_COMPONENT_ID);
        // Header: STX, length, two bytes of flags, sequence number, system, component. A HEARTBEAT
        // then has mode, type and autopilot.
        let header_fields = |raw: &MAVLinkV2MessageRaw| [4, 5, 6, 14, 15, 17].map(|index| raw.raw_bytes()[index]);
        assert_eq!(header_fields(&encoder.heartbeat(HeartbeatStatus::Starting)), [0, 7, 1, 0, 0, 1]);
        for _ in 1..256 {
            encoder.heartbeat(HeartbeatStatus::Silent);
        }
        assert_eq!(header_fields(&encoder.heartbeat(HeartbeatStatus::Active)), [0, 7, 1, 0, 0, 4]);
        assert_eq!(
            header_fields(&MavlinkEncoder::new(7, 191).heartbeat(HeartbeatStatus::Silent)),
            [0, 7, 191, 18, 8, 5]
        );
    }
}
