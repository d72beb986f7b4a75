//! ROS 2 over Zenoh, as rmw_zenoh has it: `sensor_msgs/msg/Imu`.
//!
//! Input: an attitude and the sample of its tick, in our frames. Output: keys, signs of life, attachments, CDR (XCDR1, little-endian). Frames: REP 103 and REP 145;
//! orientation of forward, left, up in east, north, up; rate and force in forward, left, up, +g upward at rest. Time: `stamp_ns`, since 1970.
//! Failure: what is no topic's name is refused.
//!
//! Sources: keys, tokens and attachments: rmw_zenoh, docs/design.md, as the crate `hiroz-protocol` 0.2.1 writes them; the type's hash: REP 2011, of
//! the definition in ROS 2 jazzy.

use attitude::frames::{Body, Frame};
use byteorder::LittleEndian;
use messages::{AttitudeOutput, ImuSample};
use runtime::frames::attitude_to_frame;
use serde::Serialize;

/// The type as keys name it, and the hash of its definition.
const IMU: [&str; 2] =
    ["sensor_msgs::msg::dds_::Imu_", "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"];
const MAGNETIC_FIELD: [&str; 2] = [
    "sensor_msgs::msg::dds_::MagneticField_",
    "RIHS01_e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
];
/// Reliable, volatile, the last ten; no deadline, no lifespan, automatic liveliness: what is usual is left out.
const QOS: &str = "::,10:,:,:,,";
/// The name of the node.
const NODE: &str = "plumbline";
/// Of plain CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// The longest name of a topic or a frame.
const MAX_NAME: usize = 200;

/// A message of ROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Message {
    /// `sensor_msgs/msg/Imu`.
    Imu,
    /// `sensor_msgs/msg/MagneticField`.
    MagneticField,
}

/// Our node, in a domain and a Zenoh session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    domain: u8,
    session: String,
}

impl Message {
    fn type_and_hash(self) -> [&'static str; 2] {
        match self {
            Self::Imu => IMU,
            Self::MagneticField => MAGNETIC_FIELD,
        }
    }
}

impl Node {
    /// `session` is its Zenoh identity.
    pub fn new(domain: u8, session: &str) -> Self {
        Self { domain, session: session.into() }
    }

    /// Says that it lives.
    pub fn sign(&self) -> String {
        self.entity(0, "NN")
    }

    /// Says that it publishes a topic, which is named without its leading slash.
    pub fn publisher_sign(&self, topic: &str, message: Message) -> String {
        self.endpoint(1, "MP", topic, message)
    }

    /// Says that it reads a topic; `number` tells those that it reads apart.
    pub fn subscription_sign(&self, number: u32, topic: &str, message: Message) -> String {
        self.endpoint(number, "MS", topic, message)
    }

    /// Under which key the messages of a topic are published.
    pub fn topic_key(&self, topic: &str, message: Message) -> String {
        let [name, hash] = message.type_and_hash();
        format!("{}/{topic}/{name}/{hash}", self.domain)
    }

    /// Under which keys they come, whatever the definition of the type in their version of ROS.
    pub fn topic_keys(&self, topic: &str, message: Message) -> String {
        let [name, _] = message.type_and_hash();
        format!("{}/{topic}/{name}/*", self.domain)
    }

    fn entity(&self, number: u32, kind: &str) -> String {
        format!("@ros2_lv/{}/{}/0/{number}/{kind}/%/%/{NODE}", self.domain, self.session)
    }

    fn endpoint(&self, number: u32, kind: &str, topic: &str, message: Message) -> String {
        let ([name, hash], mangled) = (message.type_and_hash(), topic.replace('/', "%"));
        format!("{}/%{mangled}/{name}/{hash}/{QOS}", self.entity(number, kind))
    }
}

/// A topic's name as ROS has them, without its leading slash: words of letters, digits and `_`, no digit first, with `/` between.
pub fn topic_name(text: &str) -> Result<String, String> {
    let name = text.strip_prefix('/').unwrap_or(text);
    let is_word = |word: &str| {
        !word.starts_with(|letter: char| letter.is_ascii_digit())
            && !word.is_empty()
            && word.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    let is_name = name.len() <= MAX_NAME && name.split('/').all(is_word);
    is_name.then(|| name.to_owned()).ok_or_else(|| "expected a topic's name, as imu/data".into())
}

/// The name of a frame.
pub fn frame_id(text: &str) -> Result<String, String> {
    let is_name = (1..=MAX_NAME).contains(&text.len()) && text.chars().all(|letter| letter.is_ascii_graphic());
    is_name.then(|| text.to_owned()).ok_or_else(|| "expected the name of a frame, as imu_link".into())
}

/// What goes with each message: its number from 1, when it was made, who sends it; sequences have their length before them.
pub fn attachment(number: i64, stamp_ns: i64, sender: [u8; 16]) -> Vec<u8> {
    [&number.to_le_bytes()[..], &stamp_ns.to_le_bytes(), &[sender.len() as u8], &sender].concat()
}

/// `sensor_msgs/msg/Imu` as CDR. Of orientation and rate less the bias by the system, of the force as it is calibrated; what spreads them is not known
/// but of the orientation.
pub fn imu(
    attitude: &AttitudeOutput,
    sample: &ImuSample,
    stamp_ns: i64,
    frame_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    let theirs = attitude_to_frame(Frame::EnuFlu, *attitude);
    let [w, x, y, z] = theirs.quaternion;
    let [inclination, course] = [attitude.inclination_sd_rad, attitude.course_sd_rad].map(|sd| sd * sd);
    let imu = Imu {
        header: Header {
            stamp: Time { sec: stamp_ns.div_euclid(NS_PER_S) as i32, nanosec: stamp_ns.rem_euclid(NS_PER_S) as u32 },
            frame_id,
        },
        orientation: [x, y, z, w],
        orientation_covariance: [inclination, 0.0, 0.0, 0.0, inclination, 0.0, 0.0, 0.0, course],
        angular_velocity: theirs.rate_rad_s,
        angular_velocity_covariance: UNKNOWN,
        linear_acceleration: Body::Flu.vector(sample.force_m_s2),
        linear_acceleration_covariance: UNKNOWN,
    };
    let mut bytes = ENCAPSULATION.to_vec();
    bytes.extend(cdr_encoding::to_vec::<_, LittleEndian>(&imu)?);
    Ok(bytes)
}

const NS_PER_S: i64 = 1_000_000_000;
/// A covariance that is not known, by the message's definition.
const UNKNOWN: [f64; 9] = [0.0; 9];

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

/// In the order of the definition; x y z w.
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
    fn keys_and_tokens_are_those_of_rmw_zenoh() {
        let node = Node::new(7, "a1b2");
        let of_type = IMU.join("/");
        assert_eq!(node.topic_key("imu/data", Message::Imu), format!("7/imu/data/{of_type}"));
        assert_eq!(node.topic_keys("imu/data", Message::Imu), format!("7/imu/data/{}/*", IMU[0]));
        assert_eq!(node.sign(), "@ros2_lv/7/a1b2/0/0/NN/%/%/plumbline");
        let sign = |number: u32, kind: &str| {
            format!("@ros2_lv/7/a1b2/0/{number}/{kind}/%/%/plumbline/%imu%data/{of_type}/::,10:,:,:,,")
        };
        assert_eq!(node.publisher_sign("imu/data", Message::Imu), sign(1, "MP"));
        assert_eq!(node.subscription_sign(3, "imu/data", Message::Imu), sign(3, "MS"));
    }

    #[test]
    fn a_wildcard_or_an_empty_word_is_no_name() {
        for text in ["", "/", "//a", "a//b", "a/", "a/*", "**", "a$*", "a b", "é", "1a", "a#", &"a".repeat(201)] {
            assert!(topic_name(text).is_err(), "{text}");
        }
        assert_eq!(topic_name("/imu/data_raw").as_deref(), Ok("imu/data_raw"));
        assert!(frame_id("").is_err() && frame_id("a b").is_err() && frame_id("imu_link").is_ok());
    }

    #[test]
    fn a_message_at_rest_has_its_numbers_at_the_places_of_cdr() {
        let attitude = AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], course_sd_rad: 0.5, ..Zeroable::zeroed() };
        let sample = ImuSample { force_m_s2: [0.1, 0.2, 9.8], ..Zeroable::zeroed() };
        let bytes = imu(&attitude, &sample, 1_500_000_000, "imu_link").unwrap();
        // Encapsulation; 1 s and 5·10⁸ ns; nine letters with the zero at the end; from there each number is at a multiple of 8 after the encapsulation.
        assert_eq!(&bytes[..16], &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0x65, 0xcd, 0x1d, 9, 0, 0, 0]);
        assert_eq!((&bytes[16..25], bytes.len()), (&b"imu_link\0"[..], 324));
        let numbers: Vec<f64> =
            bytes[28..].chunks_exact(8).map(|eight| f64::from_le_bytes(eight.try_into().unwrap())).collect();
        // The nose to the north is a quarter of a turn from the east.
        let h = 0.5f64.sqrt();
        assert!(numbers[..4].iter().zip([0.0, 0.0, h, h]).all(|(a, b)| (a - b).abs() < 1e-15), "{numbers:?}");
        assert_eq!((numbers[12], &numbers[25..28]), (0.25, &[0.2, -0.1, 9.8][..]));
    }

    #[test]
    fn an_attachment_is_of_33_bytes() {
        let bytes = attachment(1, -2, [3; 16]);
        assert_eq!(bytes, [&[1, 0, 0, 0, 0, 0, 0, 0, 0xfe][..], &[0xff; 7], &[16], &[3; 16]].concat());
    }
}
