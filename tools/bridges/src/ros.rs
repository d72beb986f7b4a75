//! ROS 2 over Zenoh, as rmw_zenoh encodes it: `sensor_msgs/msg/Imu`.
//!
//! - Input: an attitude and the sample of its tick, in the native frame.
//! - Output: keys, liveliness tokens, attachments, and messages as CDR (XCDR1, little-endian).
//! - Frames: REP 103 and REP 145. The orientation is that of the body axes forward, left, up in the
//!   earth axes east, north, up. Rate and force are in forward, left, up; at rest the force is +g
//!   upwards.
//! - Time: `stamp_ns` is in nanoseconds since 1970.
//! - Failure: an invalid topic or frame name is rejected.
//!
//! Sources: docs/design.md of rmw_zenoh for keys, tokens and attachments, in the form written by
//! the crate `hiroz-protocol` 0.2.1; REP 2011 for the type hashes of the message definitions in ROS
//! 2 jazzy.

use attitude::frames::{Body, Frame};
use byteorder::LittleEndian;
use messages::{AttitudeOutput, ImuSample};
use runtime::frames::attitude_to_frame;
use serde::Serialize;

/// Type name of `sensor_msgs/msg/Imu` in keys, and hash of its definition.
const IMU_TYPE_AND_HASH: [&str; 2] =
    ["sensor_msgs::msg::dds_::Imu_", "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"];
/// Type name of `sensor_msgs/msg/MagneticField` in keys, and hash of its definition.
const MAGNETIC_FIELD_TYPE_AND_HASH: [&str; 2] = [
    "sensor_msgs::msg::dds_::MagneticField_",
    "RIHS01_e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
];
/// QoS profile: reliable, volatile, history of 10. Defaults are omitted.
const QOS: &str = "::,10:,:,:,,";
const NODE_NAME: &str = "plumbline";
/// Header of plain CDR, little-endian.
const ENCAPSULATION_HEADER: [u8; 4] = [0, 1, 0, 0];
/// Maximum length of a topic or frame name.
const MAX_NAME_BYTES: usize = 200;

/// Type of a ROS message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageType {
    /// `sensor_msgs/msg/Imu`.
    Imu,
    /// `sensor_msgs/msg/MagneticField`.
    MagneticField,
}

/// ROS node in a domain and a Zenoh session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    domain: u8,
    session: String,
}

impl MessageType {
    fn type_and_hash(self) -> [&'static str; 2] {
        match self {
            Self::Imu => IMU_TYPE_AND_HASH,
            Self::MagneticField => MAGNETIC_FIELD_TYPE_AND_HASH,
        }
    }
}

impl Node {
    /// Creates a node. `session` is the identifier of the Zenoh session.
    pub fn new(domain: u8, session: &str) -> Self {
        Self { domain, session: session.into() }
    }

    /// Returns the liveliness token of the node.
    pub fn node_token(&self) -> String {
        self.entity_token(0, "NN")
    }

    /// Returns the liveliness token of a publisher. `topic` has no leading slash.
    pub fn publisher_token(&self, topic: &str, message_type: MessageType) -> String {
        self.endpoint_token(1, "MP", topic, message_type)
    }

    /// Returns the liveliness token of a subscription; `entity_id` must be unique within the node.
    pub fn subscription_token(&self, entity_id: u32, topic: &str, message_type: MessageType) -> String {
        self.endpoint_token(entity_id, "MS", topic, message_type)
    }

    /// Returns the key for publishing on a topic.
    pub fn topic_key(&self, topic: &str, message_type: MessageType) -> String {
        let [name, hash] = message_type.type_and_hash();
        format!("{}/{topic}/{name}/{hash}", self.domain)
    }

    /// Returns the key expression of a topic for any version of the type definition.
    pub fn topic_key_any_hash(&self, topic: &str, message_type: MessageType) -> String {
        let [name, _] = message_type.type_and_hash();
        format!("{}/{topic}/{name}/*", self.domain)
    }

    fn entity_token(&self, entity_id: u32, kind: &str) -> String {
        format!("@ros2_lv/{}/{}/0/{entity_id}/{kind}/%/%/{NODE_NAME}", self.domain, self.session)
    }

    fn endpoint_token(&self, entity_id: u32, kind: &str, topic: &str, message_type: MessageType) -> String {
        let ([name, hash], mangled) = (message_type.type_and_hash(), topic.replace('/', "%"));
        format!("{}/%{mangled}/{name}/{hash}/{QOS}", self.entity_token(entity_id, kind))
    }
}

/// Parses a topic name and returns it with any leading slash removed.
///
/// A name consists of words separated by `/`. A word has letters, digits and `_`, and does not
/// start with a digit.
///
/// # Errors
///
/// Returns a description of the expected name.
pub fn parse_topic_name(text: &str) -> Result<String, String> {
    let name = text.strip_prefix('/').unwrap_or(text);
    let is_word = |word: &str| {
        !word.starts_with(|letter: char| letter.is_ascii_digit())
            && !word.is_empty()
            && word.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    let is_name = name.len() <= MAX_NAME_BYTES && name.split('/').all(is_word);
    is_name.then(|| name.to_owned()).ok_or_else(|| "expected a topic name, for instance imu/data".into())
}

/// Parses a frame name: printable ASCII without spaces.
///
/// # Errors
///
/// Returns a description of the expected name.
pub fn parse_frame_id(text: &str) -> Result<String, String> {
    let is_name = (1..=MAX_NAME_BYTES).contains(&text.len()) && text.chars().all(|letter| letter.is_ascii_graphic());
    is_name.then(|| text.to_owned()).ok_or_else(|| "expected a frame name, for instance imu_link".into())
}

/// Returns the attachment of a message: sequence number from 1, time stamp and publisher
/// identifier. The identifier is preceded by its length.
pub fn attachment(sequence_number: i64, stamp_ns: i64, publisher_gid: [u8; 16]) -> Vec<u8> {
    [&sequence_number.to_le_bytes()[..], &stamp_ns.to_le_bytes(), &[publisher_gid.len() as u8], &publisher_gid].concat()
}

/// Encodes `sensor_msgs/msg/Imu` as CDR.
///
/// Orientation and bias-corrected rate are estimates; the force is the calibrated measurement. Only
/// the orientation has a known covariance.
///
/// # Errors
///
/// Returns an error if CDR cannot represent the message.
pub fn encode_imu(
    attitude: &AttitudeOutput,
    sample: &ImuSample,
    stamp_ns: i64,
    frame_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    let in_ros_frame = attitude_to_frame(Frame::EnuFlu, *attitude);
    let [w, x, y, z] = in_ros_frame.quaternion;
    let [inclination_variance, course_variance] =
        [attitude.inclination_sd_rad, attitude.course_sd_rad].map(|sd| sd * sd);
    let imu = Imu {
        header: Header {
            stamp: Time { sec: stamp_ns.div_euclid(NS_PER_S) as i32, nanosec: stamp_ns.rem_euclid(NS_PER_S) as u32 },
            frame_id,
        },
        orientation: [x, y, z, w],
        orientation_covariance: [
            inclination_variance,
            0.0,
            0.0,
            0.0,
            inclination_variance,
            0.0,
            0.0,
            0.0,
            course_variance,
        ],
        angular_velocity: in_ros_frame.rate_rad_s,
        angular_velocity_covariance: UNKNOWN_COVARIANCE,
        linear_acceleration: Body::Flu.vector(sample.force_m_s2),
        linear_acceleration_covariance: UNKNOWN_COVARIANCE,
    };
    let mut bytes = ENCAPSULATION_HEADER.to_vec();
    bytes.extend(cdr_encoding::to_vec::<_, LittleEndian>(&imu)?);
    Ok(bytes)
}

const NS_PER_S: i64 = 1_000_000_000;
/// Covariance that means "unknown" in the message definition.
const UNKNOWN_COVARIANCE: [f64; 9] = [0.0; 9];

#[derive(Serialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Serialize)]
struct Header<'a> {
    stamp: Time,
    frame_id: &'a str,
}

/// Fields in the order of the definition. The quaternion is x, y, z, w.
#[derive(Serialize)]
struct Imu<'a> {
    header: Header<'a>,
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    angular_velocity: [f64; 3],
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: [f64; 3],
    linear_acceleration_covariance: [f64; 9],
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn keys_and_tokens_match_rmw_zenoh() {
        let node = Node::new(7, "a1b2");
        let type_and_hash = IMU_TYPE_AND_HASH.join("/");
        assert_eq!(node.topic_key("imu/data", MessageType::Imu), format!("7/imu/data/{type_and_hash}"));
        assert_eq!(
            node.topic_key_any_hash("imu/data", MessageType::Imu),
            format!("7/imu/data/{}/*", IMU_TYPE_AND_HASH[0])
        );
        assert_eq!(node.node_token(), "@ros2_lv/7/a1b2/0/0/NN/%/%/plumbline");
        let token = |number: u32, kind: &str| {
            format!("@ros2_lv/7/a1b2/0/{number}/{kind}/%/%/plumbline/%imu%data/{type_and_hash}/::,10:,:,:,,")
        };
        assert_eq!(node.publisher_token("imu/data", MessageType::Imu), token(1, "MP"));
        assert_eq!(node.subscription_token(3, "imu/data", MessageType::Imu), token(3, "MS"));
    }

    #[test]
    fn wildcards_and_empty_words_are_rejected() {
        for text in ["", "/", "//a", "a//b", "a/", "a/*", "**", "a$*", "a b", "é", "1a", "a#", &"a".repeat(201)] {
            assert!(parse_topic_name(text).is_err(), "{text}");
        }
        assert_eq!(parse_topic_name("/imu/data_raw").as_deref(), Ok("imu/data_raw"));
        assert!(parse_frame_id("").is_err() && parse_frame_id("a b").is_err() && parse_frame_id("imu_link").is_ok());
    }

    #[test]
    fn imu_message_has_cdr_layout() {
        let attitude = AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], course_sd_rad: 0.5, ..Zeroable::zeroed() };
        let sample = ImuSample { force_m_s2: [0.1, 0.2, 9.8], ..Zeroable::zeroed() };
        let bytes = encode_imu(&attitude, &sample, 1_500_000_000, "imu_link").unwrap();
        // The 16 bytes are the encapsulation header, the time stamp (1 s and 5·10⁸ ns) and the
        // length of the frame name (nine bytes including the terminating zero). After the name,
        // each number is aligned to 8 bytes, counted from the end of the encapsulation header.
        assert_eq!(&bytes[..16], &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0x65, 0xcd, 0x1d, 9, 0, 0, 0]);
        assert_eq!((&bytes[16..25], bytes.len()), (&b"imu_link\0"[..], 324));
        let numbers: Vec<f64> =
            bytes[28..].chunks_exact(8).map(|eight| f64::from_le_bytes(eight.try_into().unwrap())).collect();
        // ROS measures yaw from east, so an attitude that faces north is a rotation by 90°.
        let h = 0.5f64.sqrt();
        assert!(numbers[..4].iter().zip([0.0, 0.0, h, h]).all(|(a, b)| (a - b).abs() < 1e-15), "{numbers:?}");
        assert_eq!((numbers[12], &numbers[25..28]), (0.25, &[0.2, -0.1, 9.8][..]));
    }

    #[test]
    fn attachment_has_33_bytes() {
        let bytes = attachment(1, -2, [3; 16]);
        assert_eq!(bytes, [&[1, 0, 0, 0, 0, 0, 0, 0, 0xfe][..], &[0xff; 7], &[16], &[3; 16]].concat());
    }
}
