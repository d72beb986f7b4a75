//! MAVLink 2 messages: HEARTBEAT, ATTITUDE_QUATERNION (31) and ATTITUDE (30).
//!
//! - Input: attitudes in the native frame that passed the check in [`validity`](crate::validity).
//! - Output: encoded frames. Quaternion, angles and rates have single precision. Body axes are
//!   forward, right, down; earth axes are north, east, down.
//! - Time: `time_boot_ms` is the end of the sample's interval on the source's clock, ms modulo 2³².
//!   ATTITUDE_QUATERNION and ATTITUDE of the same sample have the same value.

use attitude::frames::Frame;
use decoders::mavlink::frame::{STX_V2, checksum};
use messages::AttitudeOutput;
use runtime::frames::attitude_to_frame;

/// `MAV_COMP_ID_AUTOPILOT1`: the component that a ground station shows as the vehicle.
pub const AUTOPILOT_COMPONENT_ID: u8 = 1;
/// Version of the message definitions (common.xml).
const MAVLINK_VERSION: u8 = 3;
/// `MAV_TYPE` and `MAV_AUTOPILOT` of a vehicle of unspecified type with a generic autopilot.
const VEHICLE: [u8; 2] = [0, 0];
/// `MAV_TYPE_ONBOARD_CONTROLLER` with `MAV_AUTOPILOT_INVALID`.
const COMPANION: [u8; 2] = [18, 8];

/// Identifier and CRC seed of a message.
struct MessageKind {
    id: u8,
    crc_extra: u8,
}

const HEARTBEAT: MessageKind = MessageKind { id: 0, crc_extra: 50 };
const ATTITUDE: MessageKind = MessageKind { id: 30, crc_extra: 39 };
const ATTITUDE_QUATERNION: MessageKind = MessageKind { id: 31, crc_extra: 246 };

/// Encodes the messages of one MAVLink component, with consecutive sequence numbers.
#[derive(Debug)]
pub struct MavlinkEncoder {
    system_id: u8,
    component_id: u8,
    sequence: u8,
}

/// System status reported by HEARTBEAT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeartbeatStatus {
    /// No attitude has been sent yet: `MAV_STATE_BOOT`.
    Starting = 1,
    /// Attitudes are being sent: `MAV_STATE_ACTIVE`.
    Active = 4,
    /// Attitudes were sent, but not recently: `MAV_STATE_CRITICAL`.
    Silent = 5,
}

/// Attitude of one tick in the units and axes of MAVLink.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MavlinkAttitude {
    /// End of the sample's interval, ms modulo 2³².
    pub time_boot_ms: u32,
    /// Quaternion, w first.
    pub quaternion: [f32; 4],
    /// Roll, pitch, yaw, rad.
    pub angles_rad: [f32; 3],
    /// Body rate about forward, right, down, rad/s.
    pub rate_rad_s: [f32; 3],
}

impl MavlinkEncoder {
    /// Creates an encoder for a component of a system. Both identifiers must be from 1 to 255.
    pub fn new(system_id: u8, component_id: u8) -> Self {
        Self { system_id, component_id, sequence: 0 }
    }

    /// Encodes a heartbeat.
    ///
    /// The component [`AUTOPILOT_COMPONENT_ID`] is reported as a generic autopilot, any other one
    /// as a companion computer.
    pub fn heartbeat(&mut self, status: HeartbeatStatus) -> Vec<u8> {
        let [kind, autopilot] = if self.component_id == AUTOPILOT_COMPONENT_ID { VEHICLE } else { COMPANION };
        // Custom mode and base mode are 0.
        self.encode(HEARTBEAT, &[0, 0, 0, 0, kind, autopilot, 0, status as u8, MAVLINK_VERSION])
    }

    /// Encodes ATTITUDE_QUATERNION. The rotation for display is left unspecified.
    pub fn attitude_quaternion(&mut self, attitude: &MavlinkAttitude) -> Vec<u8> {
        self.encode(ATTITUDE_QUATERNION, &attitude.payload(&attitude.quaternion))
    }

    /// Encodes ATTITUDE.
    pub fn attitude(&mut self, attitude: &MavlinkAttitude) -> Vec<u8> {
        self.encode(ATTITUDE, &attitude.payload(&attitude.angles_rad))
    }

    /// Encodes a message with the next sequence number.
    fn encode(&mut self, kind: MessageKind, payload: &[u8]) -> Vec<u8> {
        // Trailing zeros are omitted, except the first byte.
        let length = payload.iter().rposition(|byte| *byte != 0).map_or(1, |last| last + 1);
        let MessageKind { id, crc_extra } = kind;
        // The two bytes after the length are flags.
        let mut frame = vec![STX_V2, length as u8, 0, 0, self.sequence, self.system_id, self.component_id, id, 0, 0];
        frame.extend_from_slice(&payload[..length]);
        frame.extend(checksum(&frame[1..], crc_extra).to_le_bytes());
        self.sequence = self.sequence.wrapping_add(1);
        frame
    }
}

impl MavlinkAttitude {
    /// Converts an attitude to MAVLink.
    pub fn new(output: &AttitudeOutput) -> Self {
        let AttitudeOutput { header, quaternion, yaw_rad, pitch_rad, roll_rad, rate_rad_s, .. } =
            attitude_to_frame(Frame::NedFrd, *output);
        Self {
            time_boot_ms: header.t_end_ns.div_euclid(1_000_000) as u32,
            quaternion: quaternion.map(|part| part as f32),
            angles_rad: [roll_rad, pitch_rad, yaw_rad].map(|angle| angle as f32),
            rate_rad_s: rate_rad_s.map(|part| part as f32),
        }
    }

    /// Returns the payload with time, `rotation` and rate.
    fn payload(&self, rotation: &[f32]) -> Vec<u8> {
        let numbers = rotation.iter().chain(&self.rate_rad_s).flat_map(|number| number.to_le_bytes());
        self.time_boot_ms.to_le_bytes().into_iter().chain(numbers).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_6;

    use bytemuck::Zeroable;
    use mavlink::{
        MAVLinkV2MessageRaw, MavHeader, Message as _,
        dialects::common::{
            ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState,
            MavType,
        },
    };

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
        let found = MavlinkAttitude::new(&output);
        let is_close = |found: &[f32], expected: &[f64]| {
            found.iter().zip(expected).all(|(found, wanted)| (f64::from(*found) - wanted).abs() < 1e-7)
        };
        // Rotation about down by 90°, then about right by 30°: qz(90°) qy(30°).
        assert!(is_close(&found.quaternion, &[h * c, -h * s, h * s, h * c]), "{found:?}");
        assert!(is_close(&found.angles_rad, &[0.0, FRAC_PI_6, std::f64::consts::FRAC_PI_2]), "{found:?}");
        assert!(is_close(&found.rate_rad_s, &[0.2, 0.1, -0.3]), "{found:?}");
    }

    #[test]
    fn frames_are_those_of_crate_mavlink() {
        let expected = |sequence, message: MavMessage| {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message(MavHeader { system_id: 7, component_id: 191, sequence }, &message);
            raw.raw_bytes().to_vec()
        };
        let mut encoder = MavlinkEncoder::new(7, 191);
        let heartbeat = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_CRITICAL,
            mavlink_version: 3,
        });
        assert_eq!(encoder.heartbeat(HeartbeatStatus::Silent), expected(0, heartbeat));
        // Some of the payloads end with zero bytes, which the encoder omits.
        for (round, scale) in [1.0f32, 0.0].into_iter().enumerate() {
            for last in [0.75f32, 2.0, 0.0] {
                let (time_boot_ms, [q1, q2, q3, q4]) = (0xffff_fffe * (1 - round as u32), [0.5, -0.5, 0.1, 0.7]);
                let attitude = MavlinkAttitude {
                    time_boot_ms,
                    quaternion: [q1, q2, q3, q4].map(|part| part * scale),
                    angles_rad: [-3.0, 1.5, 0.1].map(|part| part * scale),
                    rate_rad_s: [0.3 * scale, -7.0 * scale, last],
                };
                let [q1, q2, q3, q4] = attitude.quaternion;
                let ([roll, pitch, yaw], [rollspeed, pitchspeed, yawspeed]) =
                    (attitude.angles_rad, attitude.rate_rad_s);
                let quaternion = MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                    time_boot_ms,
                    q1,
                    q2,
                    q3,
                    q4,
                    rollspeed,
                    pitchspeed,
                    yawspeed,
                    repr_offset_q: [0.0; 4],
                });
                let angles = MavMessage::ATTITUDE(ATTITUDE_DATA {
                    time_boot_ms,
                    roll,
                    pitch,
                    yaw,
                    rollspeed,
                    pitchspeed,
                    yawspeed,
                });
                let sequence = encoder.sequence;
                assert_eq!(encoder.attitude_quaternion(&attitude), expected(sequence, quaternion), "{attitude:?}");
                assert_eq!(encoder.attitude(&attitude), expected(sequence + 1, angles), "{attitude:?}");
            }
        }
        for MessageKind { id, crc_extra } in [HEARTBEAT, ATTITUDE, ATTITUDE_QUATERNION] {
            assert_eq!(crc_extra, MavMessage::extra_crc(id.into()));
        }
    }

    #[test]
    fn messages_are_numbered_and_companion_is_not_autopilot() {
        let mut encoder = MavlinkEncoder::new(7, AUTOPILOT_COMPONENT_ID);
        // Header: STX, length, two bytes of flags, sequence number, system, component. A HEARTBEAT
        // then has mode, type and autopilot.
        let header_fields = |frame: &[u8]| [4, 5, 6, 14, 15, 17].map(|index| frame[index]);
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
