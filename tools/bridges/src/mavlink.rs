//! MAVLink 2 messages: HEARTBEAT, ATTITUDE_QUATERNION (31), ATTITUDE (30), ODOMETRY (331) and
//! GLOBAL_POSITION_INT (33).
//!
//! - Input: attitudes in the native frame that passed the check in [`validity`](crate::validity),
//!   and fixes.
//! - Output: encoded frames. Quaternion, angles and rates have single precision. Body axes are
//!   forward, right, down; earth axes are north, east, down.
//! - Time: `time_boot_ms` is the end of the sample's interval on the source's clock, ms modulo 2³².
//!   ATTITUDE_QUATERNION and ATTITUDE of the same sample have the same value; `time_usec` of
//!   ODOMETRY is the same time in µs.
//! - Failure: an unknown value is sent as the number that the message definition (common.xml)
//!   reserves for unknown values. A fix without a complete position yields no message.

use attitude::frames::{Earth, Frame};
use decoders::mavlink::frame::{STX_V2, checksum};
use messages::{AttitudeOutput, CourseReference, GnssFix};
use runtime::frames::attitude_to_frame;

/// `MAV_COMP_ID_AUTOPILOT1`: the component that a ground station shows as the vehicle.
pub const AUTOPILOT_COMPONENT_ID: u8 = 1;
/// `MAV_COMP_ID_ONBOARD_COMPUTER`: a component of a vehicle other than the autopilot.
pub const ONBOARD_COMPUTER_COMPONENT_ID: u8 = 191;
/// Version of the message definitions (common.xml).
const MAVLINK_VERSION: u8 = 3;
/// `MAV_TYPE` and `MAV_AUTOPILOT` of a vehicle of unspecified type with a generic autopilot.
const VEHICLE: [u8; 2] = [0, 0];
/// `MAV_TYPE_ONBOARD_CONTROLLER` with `MAV_AUTOPILOT_INVALID`.
const COMPANION: [u8; 2] = [18, 8];
/// `MAV_FRAME_LOCAL_NED`: north, east, down, with true north.
const LOCAL_NED: u8 = 1;
/// `MAV_FRAME_BODY_FRD`: body axes forward, right, down.
const BODY_FRD: u8 = 12;
/// `MAV_FRAME_LOCAL_FRD`: level axes. The first axis does not point to true north.
const LOCAL_FRD: u8 = 20;
/// `MAV_ESTIMATOR_TYPE_UNKNOWN`, because no other type describes an estimator that estimates only
/// the attitude.
const UNKNOWN_ESTIMATOR: u8 = 0;
/// Unknown `quality` of ODOMETRY.
const UNKNOWN_QUALITY: u8 = 0;
/// Unknown `hdg` of GLOBAL_POSITION_INT.
const UNKNOWN_HEADING: u16 = u16::MAX;
/// Number of entries in the upper right triangle of a covariance matrix of ODOMETRY.
const COVARIANCE_LEN: usize = 21;
/// Indices of the variances of roll, pitch and yaw in the upper right triangle of a covariance
/// matrix.
const ROTATION_VARIANCES: [usize; 3] = [15, 18, 20];

/// Identifier and CRC seed of a message type.
struct MessageKind {
    id: u16,
    crc_extra: u8,
}

const HEARTBEAT: MessageKind = MessageKind { id: 0, crc_extra: 50 };
const ATTITUDE: MessageKind = MessageKind { id: 30, crc_extra: 39 };
const ATTITUDE_QUATERNION: MessageKind = MessageKind { id: 31, crc_extra: 246 };
const GLOBAL_POSITION_INT: MessageKind = MessageKind { id: 33, crc_extra: 104 };
const ODOMETRY: MessageKind = MessageKind { id: 331, crc_extra: 91 };

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
    /// End of the sample's interval, µs; 0 if it is negative.
    pub time_usec: u64,
    /// Quaternion, w first.
    pub quaternion: [f32; 4],
    /// Roll, pitch, yaw, rad.
    pub angles_rad: [f32; 3],
    /// Body rate about forward, right, down, rad/s.
    pub rate_rad_s: [f32; 3],
    /// Variances of roll, pitch and yaw, rad².
    pub variance_rad2: [f32; 3],
    /// `true` if the zero direction of yaw is true north.
    pub is_true_north: bool,
    /// Number of re-initialisations of the attitude, modulo 256.
    pub reset_counter: u8,
}

/// Position and velocity of a fix in the units and axes of MAVLink.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MavlinkPosition {
    /// Time of the fix, ms modulo 2³².
    pub time_boot_ms: u32,
    /// Latitude and longitude, 10⁻⁷ °.
    pub position_e7_deg: [i32; 2],
    /// Altitude as given by the receiver, mm.
    pub altitude_mm: i32,
    /// Altitude above the first fix that was sent, mm.
    pub relative_altitude_mm: i32,
    /// Velocity north, east, down, cm/s.
    pub velocity_cm_s: [i16; 3],
    /// Heading clockwise from true north, 0.01°; [`u16::MAX`] if unknown.
    pub heading_cdeg: u16,
}

impl MavlinkEncoder {
    /// Creates an encoder for a component of a system. Both identifiers must be from 1 to 255.
    pub fn new(system_id: u8, component_id: u8) -> Self {
        Self { system_id, component_id, sequence: 0 }
    }

    /// Encodes a heartbeat.
    ///
    /// The component [`AUTOPILOT_COMPONENT_ID`] is reported as a generic autopilot, any other
    /// component as a companion computer.
    pub fn heartbeat(&mut self, status: HeartbeatStatus) -> Vec<u8> {
        let [kind, autopilot] = if self.component_id == AUTOPILOT_COMPONENT_ID { VEHICLE } else { COMPANION };
        // Custom mode and base mode are 0.
        self.encode(HEARTBEAT, &[0, 0, 0, 0, kind, autopilot, 0, status as u8, MAVLINK_VERSION])
    }

    /// Encodes ATTITUDE_QUATERNION. The optional field `repr_offset_q` is omitted.
    pub fn attitude_quaternion(&mut self, attitude: &MavlinkAttitude) -> Vec<u8> {
        self.encode(ATTITUDE_QUATERNION, &attitude.payload(&attitude.quaternion))
    }

    /// Encodes ATTITUDE.
    pub fn attitude(&mut self, attitude: &MavlinkAttitude) -> Vec<u8> {
        self.encode(ATTITUDE, &attitude.payload(&attitude.angles_rad))
    }

    /// Encodes ODOMETRY.
    ///
    /// Position and velocity are NaN, because the system estimates neither. Of the covariances,
    /// only the variances of the rotation are known.
    pub fn odometry(&mut self, attitude: &MavlinkAttitude) -> Vec<u8> {
        let unknown = [f32::NAN; 3];
        let mut pose_covariance = [f32::NAN; COVARIANCE_LEN];
        for (index, variance) in ROTATION_VARIANCES.into_iter().zip(attitude.variance_rad2) {
            pose_covariance[index] = variance;
        }
        let numbers = [
            &unknown[..],
            &attitude.quaternion,
            &unknown,
            &attitude.rate_rad_s,
            &pose_covariance,
            &[f32::NAN; COVARIANCE_LEN],
        ];
        let frame = if attitude.is_true_north { LOCAL_NED } else { LOCAL_FRD };
        let mut payload = attitude.time_usec.to_le_bytes().to_vec();
        payload.extend(numbers.concat().iter().flat_map(|number| number.to_le_bytes()));
        payload.extend([frame, BODY_FRD, attitude.reset_counter, UNKNOWN_ESTIMATOR, UNKNOWN_QUALITY]);
        self.encode(ODOMETRY, &payload)
    }

    /// Encodes GLOBAL_POSITION_INT.
    pub fn global_position(&mut self, position: &MavlinkPosition) -> Vec<u8> {
        let [latitude, longitude] = position.position_e7_deg;
        let words = [latitude, longitude, position.altitude_mm, position.relative_altitude_mm];
        let mut payload = position.time_boot_ms.to_le_bytes().to_vec();
        payload.extend(words.into_iter().flat_map(i32::to_le_bytes));
        payload.extend(position.velocity_cm_s.into_iter().flat_map(i16::to_le_bytes));
        payload.extend(position.heading_cdeg.to_le_bytes());
        self.encode(GLOBAL_POSITION_INT, &payload)
    }

    /// Encodes a message with the next sequence number.
    fn encode(&mut self, kind: MessageKind, payload: &[u8]) -> Vec<u8> {
        // Trailing zeros are omitted, except the first byte.
        let length = payload.iter().rposition(|byte| *byte != 0).map_or(1, |last| last + 1);
        let MessageKind { id, crc_extra } = kind;
        let [id_low, id_high] = id.to_le_bytes();
        // The two bytes after the length are flags.
        let mut frame = vec![STX_V2, length as u8, 0, 0, self.sequence, self.system_id, self.component_id];
        frame.extend([id_low, id_high, 0]);
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
        let variance = |sd_rad: f64| (sd_rad * sd_rad) as f32;
        let [inclination, course] = [output.inclination_sd_rad, output.course_sd_rad].map(variance);
        Self {
            time_boot_ms: boot_ms(header.t_end_ns),
            time_usec: u64::try_from(header.t_end_ns / 1000).unwrap_or(0),
            quaternion: quaternion.map(|part| part as f32),
            angles_rad: [roll_rad, pitch_rad, yaw_rad].map(|angle| angle as f32),
            rate_rad_s: rate_rad_s.map(|part| part as f32),
            variance_rad2: [inclination, inclination, course],
            is_true_north: output.course_reference == CourseReference::TRUE,
            reset_counter: output.reset_counter as u8,
        }
    }

    /// Returns the payload that consists of time, `rotation` and body rate.
    fn payload(&self, rotation: &[f32]) -> Vec<u8> {
        let numbers = rotation.iter().chain(&self.rate_rad_s).flat_map(|number| number.to_le_bytes());
        self.time_boot_ms.to_le_bytes().into_iter().chain(numbers).collect()
    }
}

impl MavlinkPosition {
    /// Converts a fix to MAVLink. Returns `None` if latitude, longitude, altitude or velocity is
    /// unknown.
    ///
    /// The time is that of the velocity measurement, if the age of the velocity is known.
    /// `first_altitude_m` is the altitude of the first fix that was sent, or `None` for that fix.
    /// The heading is taken from `attitude` and is known only if its zero direction is true north.
    pub fn new(fix: &GnssFix, first_altitude_m: Option<f64>, attitude: Option<&MavlinkAttitude>) -> Option<Self> {
        let GnssFix { header, velocity_m_s, age_s, latitude_rad, longitude_rad, altitude_m, .. } = *fix;
        let needed = [latitude_rad, longitude_rad, altitude_m];
        if !needed.iter().chain(&velocity_m_s).all(|number| number.is_finite()) {
            return None;
        }
        let age_ns = if age_s.is_finite() { (age_s * 1e9) as i64 } else { 0 };
        let mm = |height_m: f64| (height_m * 1000.0).round() as i32;
        let heading = attitude.filter(|attitude| attitude.is_true_north).map(|attitude| {
            let [_, _, yaw_rad] = attitude.angles_rad;
            // 359.996° rounds to 0.
            (f64::from(yaw_rad).to_degrees().rem_euclid(360.0) * 100.0).round() as u16 % 36_000
        });
        Some(Self {
            time_boot_ms: boot_ms(header.t_end_ns.saturating_sub(age_ns)),
            position_e7_deg: [latitude_rad, longitude_rad].map(|rad| (rad.to_degrees() * 1e7).round() as i32),
            altitude_mm: mm(altitude_m),
            relative_altitude_mm: mm(altitude_m - first_altitude_m.unwrap_or(altitude_m)),
            velocity_cm_s: Earth::Ned.vector(velocity_m_s).map(|part_m_s| (part_m_s * 100.0).round() as i16),
            heading_cdeg: heading.unwrap_or(UNKNOWN_HEADING),
        })
    }
}

fn boot_ms(t_ns: i64) -> u32 {
    t_ns.div_euclid(1_000_000) as u32
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_6;

    use bytemuck::Zeroable;
    use mavlink::{
        MAVLinkV2MessageRaw, MavHeader, Message as _,
        dialects::common::{
            ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, GLOBAL_POSITION_INT_DATA, HEARTBEAT_DATA, MavAutopilot,
            MavEstimatorType, MavFrame, MavMessage, MavModeFlag, MavState, MavType, ODOMETRY_DATA,
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

    /// Returns the frame that the crate `mavlink` encodes.
    fn expected(sequence: u8, message: MavMessage) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(MavHeader { system_id: 7, component_id: 191, sequence }, &message);
        raw.raw_bytes().to_vec()
    }

    #[test]
    fn frames_are_those_of_crate_mavlink() {
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
                    ..MavlinkAttitude::new(&Zeroable::zeroed())
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
        for MessageKind { id, crc_extra } in [HEARTBEAT, ATTITUDE, ATTITUDE_QUATERNION, GLOBAL_POSITION_INT, ODOMETRY] {
            assert_eq!(crc_extra, MavMessage::extra_crc(id.into()));
        }
    }

    #[test]
    fn odometry_has_rotation_only_in_frame_of_course() {
        let mut output = AttitudeOutput {
            quaternion: [1.0, 0.0, 0.0, 0.0],
            rate_rad_s: [0.1, 0.2, 0.3],
            inclination_sd_rad: 0.5,
            course_sd_rad: 2.0,
            reset_counter: 0x103,
            ..Zeroable::zeroed()
        };
        output.header.t_end_ns = 5_000_001_999;
        for (course_reference, frame_id) in [
            (CourseReference::TRUE, MavFrame::MAV_FRAME_LOCAL_NED),
            (CourseReference::MAGNETIC, MavFrame::MAV_FRAME_LOCAL_FRD),
            (CourseReference::ARBITRARY, MavFrame::MAV_FRAME_LOCAL_FRD),
        ] {
            let attitude = MavlinkAttitude::new(&AttitudeOutput { course_reference, ..output });
            let [rollspeed, pitchspeed, yawspeed] = attitude.rate_rad_s;
            let mut pose_covariance = [f32::NAN; COVARIANCE_LEN];
            // Row-major triangle of six states: the rows have 6, 5, 4, 3, 2 and 1 entries.
            (pose_covariance[6 + 5 + 4], pose_covariance[6 + 5 + 4 + 3]) = (0.25, 0.25);
            pose_covariance[COVARIANCE_LEN - 1] = 4.0;
            let odometry = MavMessage::ODOMETRY(ODOMETRY_DATA {
                time_usec: 5_000_001,
                frame_id,
                child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
                x: f32::NAN,
                y: f32::NAN,
                z: f32::NAN,
                q: attitude.quaternion,
                vx: f32::NAN,
                vy: f32::NAN,
                vz: f32::NAN,
                rollspeed,
                pitchspeed,
                yawspeed,
                pose_covariance,
                velocity_covariance: [f32::NAN; COVARIANCE_LEN],
                reset_counter: 3,
                estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_UNKNOWN,
                quality: 0,
            });
            assert_eq!(MavlinkEncoder::new(7, 191).odometry(&attitude), expected(0, odometry), "{attitude:?}");
        }
    }

    /// Fix at 45° south, 120° west, moving east, north and up.
    fn fix() -> GnssFix {
        let mut fix = GnssFix {
            velocity_m_s: [1.0, 2.5, -400.0],
            age_s: 0.25,
            latitude_rad: (-45f64).to_radians(),
            longitude_rad: (-120f64).to_radians(),
            altitude_m: 100.5,
            ..Zeroable::zeroed()
        };
        fix.header.t_end_ns = 2_000_000_000;
        fix
    }

    #[test]
    fn global_position_has_units_and_axes_of_mavlink() {
        let attitude = |course_reference, yaw_rad| {
            MavlinkAttitude::new(&AttitudeOutput { course_reference, yaw_rad, ..Zeroable::zeroed() })
        };
        // Yaw is counter-clockwise in the native frame and clockwise in MAVLink.
        let north_by_west = attitude(CourseReference::TRUE, 0.1f64.to_radians());
        let position = MavlinkPosition::new(&fix(), Some(98.0), Some(&north_by_west)).unwrap();
        let message = MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
            time_boot_ms: 1750,
            lat: -450_000_000,
            lon: -1_200_000_000,
            alt: 100_500,
            relative_alt: 2500,
            vx: 250,
            vy: 100,
            vz: i16::MAX,
            hdg: 35_990,
        });
        assert_eq!(MavlinkEncoder::new(7, 191).global_position(&position), expected(0, message), "{position:?}");
        let heading = |attitude: Option<&MavlinkAttitude>| {
            MavlinkPosition::new(&fix(), None, attitude).map(|position| position.heading_cdeg)
        };
        let tiny = attitude(CourseReference::TRUE, 1e-6);
        assert_eq!(heading(Some(&tiny)), Some(0), "a full turn is 0");
        assert_eq!(heading(Some(&attitude(CourseReference::MAGNETIC, 0.5))), Some(UNKNOWN_HEADING));
        assert_eq!(heading(None), Some(UNKNOWN_HEADING));
    }

    #[test]
    fn fix_without_complete_position_has_no_message() {
        let complete = |change: fn(&mut GnssFix)| {
            let mut fix = fix();
            change(&mut fix);
            MavlinkPosition::new(&fix, None, None)
        };
        assert_eq!(complete(|fix| fix.latitude_rad = f64::NAN), None);
        assert_eq!(complete(|fix| fix.longitude_rad = f64::NAN), None);
        assert_eq!(complete(|fix| fix.altitude_m = f64::NAN), None);
        assert_eq!(complete(|fix| fix.velocity_m_s[2] = f64::NAN), None);
        let without_age = complete(|fix| fix.age_s = f64::NAN).unwrap();
        assert_eq!((without_age.time_boot_ms, without_age.relative_altitude_mm), (2000, 0));
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
