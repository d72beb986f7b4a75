//! MAVLink 2: HEARTBEAT, ATTITUDE_QUATERNION (31) and ATTITUDE (30).
//!
//! Input: attitudes in our frames. Output: frames of bytes; quaternion, angles and rates of forward, right, down in north, east, down, single
//! precision. Time: `time_boot_ms` is the end of the sample's interval on the source's clock, ms modulo 2³², so that both messages and
//! whatever else is known of a sample can be brought together. Failure: none; what is given is [sound](crate::soundness).

use attitude::frames::Frame;
use mavlink::{
    MAVLinkV2MessageRaw, MavHeader, MessageData,
    dialects::ardupilotmega::{
        ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, HEARTBEAT_DATA, MavAutopilot, MavModeFlag, MavState, MavType,
    },
};
use messages::AttitudeOutput;
use runtime::frames::attitude_to_frame;

/// `MAV_COMP_ID_AUTOPILOT1`: the component that ground stations take for the vehicle.
pub const AUTOPILOT: u8 = 1;
/// Of the messages' definitions (common.xml).
const MAVLINK_VERSION: u8 = 3;

/// Who speaks, and the number of the next message.
#[derive(Debug)]
pub struct Speaker {
    header: MavHeader,
}

/// How the system is, as HEARTBEAT tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    /// No attitude has been sent.
    Starting,
    /// Attitudes are sent.
    Active,
    /// They were, and are not any more.
    Silent,
}

/// The attitude of one tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Attitude {
    /// As a quaternion, w first.
    pub quaternion: ATTITUDE_QUATERNION_DATA,
    /// As angles.
    pub angles: ATTITUDE_DATA,
}

impl Speaker {
    /// A component of a system, both 1 to 255.
    pub fn new(system: u8, component: u8) -> Self {
        Self { header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 } }
    }

    /// The component that a ground station takes for the vehicle is a generic autopilot, any other a companion computer.
    pub fn heartbeat(&mut self, condition: Condition) -> MAVLinkV2MessageRaw {
        let (mavtype, autopilot) = match self.header.component_id {
            AUTOPILOT => (MavType::MAV_TYPE_GENERIC, MavAutopilot::MAV_AUTOPILOT_GENERIC),
            _ => (MavType::MAV_TYPE_ONBOARD_CONTROLLER, MavAutopilot::MAV_AUTOPILOT_INVALID),
        };
        let system_status = match condition {
            Condition::Starting => MavState::MAV_STATE_BOOT,
            Condition::Active => MavState::MAV_STATE_ACTIVE,
            Condition::Silent => MavState::MAV_STATE_CRITICAL,
        };
        let base_mode = MavModeFlag::empty();
        let mavlink_version = MAVLINK_VERSION;
        self.frame(&HEARTBEAT_DATA { custom_mode: 0, mavtype, autopilot, base_mode, system_status, mavlink_version })
    }

    /// A message as bytes, with the next number.
    pub fn frame(&mut self, message: &impl MessageData) -> MAVLinkV2MessageRaw {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message_data(self.header, message);
        self.header.sequence = self.header.sequence.wrapping_add(1);
        raw
    }
}

/// An attitude as MAVLink has it.
pub fn attitude(output: &AttitudeOutput) -> Attitude {
    let AttitudeOutput { header, quaternion, yaw_rad, pitch_rad, roll_rad, rate_rad_s, .. } =
        attitude_to_frame(Frame::NedFrd, *output);
    let time_boot_ms = header.t_end_ns.div_euclid(1_000_000) as u32;
    let [q1, q2, q3, q4] = quaternion.map(|part| part as f32);
    let [rollspeed, pitchspeed, yawspeed] = rate_rad_s.map(|part| part as f32);
    let [roll, pitch, yaw] = [roll_rad, pitch_rad, yaw_rad].map(|angle| angle as f32);
    Attitude {
        quaternion: ATTITUDE_QUATERNION_DATA {
            time_boot_ms,
            q1,
            q2,
            q3,
            q4,
            rollspeed,
            pitchspeed,
            yawspeed,
            // Of a body whose level is another one; all zero: of none.
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
    fn a_climb_to_the_east_has_north_east_down_and_forward_right_down() {
        let (s, c) = (FRAC_PI_6 / 2.0).sin_cos();
        let h = 0.5f64.sqrt();
        // Ours: a quarter of a turn clockwise from above, then the nose up by 30° about the right axis.
        let quaternion = [h * c, h * s, -h * s, -h * c];
        let output = AttitudeOutput {
            quaternion,
            yaw_rad: -std::f64::consts::FRAC_PI_2,
            pitch_rad: FRAC_PI_6,
            rate_rad_s: [0.1, 0.2, 0.3],
            ..Zeroable::zeroed()
        };
        let Attitude { quaternion: q, angles: a } = attitude(&output);
        let near = |found: [f32; 4], wanted: [f64; 4]| {
            found.iter().zip(wanted).all(|(found, wanted)| (f64::from(*found) - wanted).abs() < 1e-7)
        };
        // About down by 90°, then about right by 30°: qz(90°) qy(30°).
        assert!(near([q.q1, q.q2, q.q3, q.q4], [h * c, -h * s, h * s, h * c]), "{q:?}");
        assert!(near([a.roll, a.pitch, a.yaw, 0.0], [0.0, FRAC_PI_6, std::f64::consts::FRAC_PI_2, 0.0]), "{a:?}");
        assert!(near([a.rollspeed, a.pitchspeed, a.yawspeed, 0.0], [0.2, 0.1, -0.3, 0.0]), "{a:?}");
    }

    #[test]
    fn messages_are_numbered_and_a_companion_is_no_vehicle() {
        let mut speaker = Speaker::new(7, AUTOPILOT);
        // STX, length, two bytes of flags, number, system, component; then of HEARTBEAT the mode, the type and the autopilot.
        let head = |raw: &MAVLinkV2MessageRaw| [4, 5, 6, 14, 15, 17].map(|place| raw.raw_bytes()[place]);
        assert_eq!(head(&speaker.heartbeat(Condition::Starting)), [0, 7, 1, 0, 0, 1]);
        for _ in 1..256 {
            speaker.heartbeat(Condition::Silent);
        }
        assert_eq!(head(&speaker.heartbeat(Condition::Active)), [0, 7, 1, 0, 0, 4]);
        assert_eq!(head(&Speaker::new(7, 191).heartbeat(Condition::Silent)), [0, 7, 191, 18, 8, 5]);
    }
}
