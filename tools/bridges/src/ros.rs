//! Nodes, publishers and subscriptions of ROS 2 over Zenoh, as rmw_zenoh declares them.
//!
//! - Input: names and types of topics.
//! - Output: keys, liveliness tokens and attachments. [`ros_messages`](crate::ros_messages) encodes
//!   the messages.
//! - Failure: an invalid topic or frame name is rejected.
//!
//! Sources: keys, tokens and attachments follow docs/design.md of rmw_zenoh, and are written like
//! those of the crate `hiroz-protocol` 0.2.1. The type hashes follow REP 2011. They were computed
//! by `rosbags` from the message definitions of ROS 2 jazzy.

/// Type name of `sensor_msgs/msg/Imu` in keys, and hash of its definition.
const IMU_TYPE_AND_HASH: [&str; 2] =
    ["sensor_msgs::msg::dds_::Imu_", "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"];
/// Type name of `sensor_msgs/msg/MagneticField` in keys, and hash of its definition.
const MAGNETIC_FIELD_TYPE_AND_HASH: [&str; 2] = [
    "sensor_msgs::msg::dds_::MagneticField_",
    "RIHS01_e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
];
/// Type name of `tf2_msgs/msg/TFMessage` in keys, and hash of its definition.
const TF_MESSAGE_TYPE_AND_HASH: [&str; 2] =
    ["tf2_msgs::msg::dds_::TFMessage_", "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"];
/// Type name of `diagnostic_msgs/msg/DiagnosticArray` in keys, and hash of its definition.
const DIAGNOSTIC_ARRAY_TYPE_AND_HASH: [&str; 2] = [
    "diagnostic_msgs::msg::dds_::DiagnosticArray_",
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
];
/// QoS profile: reliable, volatile, history depth 10. Values that equal the defaults are omitted.
const QOS: &str = "::,10:,:,:,,";
/// Name of the node.
pub const NODE_NAME: &str = "plumbline";
/// Maximum length of a topic or frame name.
const MAX_NAME_BYTES: usize = 200;

/// Type of a ROS message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageType {
    /// `sensor_msgs/msg/Imu`.
    Imu,
    /// `sensor_msgs/msg/MagneticField`.
    MagneticField,
    /// `tf2_msgs/msg/TFMessage`.
    TfMessage,
    /// `diagnostic_msgs/msg/DiagnosticArray`.
    DiagnosticArray,
}

/// Identity of a ROS node: its ROS domain and its Zenoh session.
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
            Self::TfMessage => TF_MESSAGE_TYPE_AND_HASH,
            Self::DiagnosticArray => DIAGNOSTIC_ARRAY_TYPE_AND_HASH,
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

    /// Returns the liveliness token of a publisher; `entity_id` must be unique within the node.
    /// `topic` has no leading slash.
    pub fn publisher_token(&self, entity_id: u32, topic: &str, message_type: MessageType) -> String {
        self.endpoint_token(entity_id, "MP", topic, message_type)
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

/// Returns the attachment of a message: sequence number from 1, timestamp and publisher identifier.
/// The identifier is preceded by its length.
pub fn attachment(sequence_number: i64, stamp_ns: i64, publisher_gid: [u8; 16]) -> Vec<u8> {
    [&sequence_number.to_le_bytes()[..], &stamp_ns.to_le_bytes(), &[publisher_gid.len() as u8], &publisher_gid].concat()
}

/// Returns the identifier of a publisher, which is unique within the session.
pub fn publisher_gid(session_id: [u8; 16], entity_id: u32) -> [u8; 16] {
    let mut gid = session_id;
    gid.iter_mut().zip(entity_id.to_le_bytes()).for_each(|(byte, part)| *byte ^= part);
    gid
}

#[cfg(test)]
mod tests {
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
        assert_eq!(node.publisher_token(1, "imu/data", MessageType::Imu), token(1, "MP"));
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
    fn attachment_has_33_bytes() {
        let bytes = attachment(1, -2, [3; 16]);
        assert_eq!(bytes, [&[1, 0, 0, 0, 0, 0, 0, 0, 0xfe][..], &[0xff; 7], &[16], &[3; 16]].concat());
    }
    #[test]
    fn publishers_of_a_session_have_different_gids() {
        let gids = [1, 2, 3].map(|entity_id| publisher_gid([7; 16], entity_id));
        assert!(gids[0] != gids[1] && gids[1] != gids[2] && gids[0] != gids[2], "{gids:?}");
        assert_ne!(publisher_gid([7; 16], 1), publisher_gid([8; 16], 1));
    }
}
