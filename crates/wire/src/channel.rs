//! Channels for flight recordings and viewers: topic messages as timestamped protobuf.
//!
//! Attitude and position are also offered in the message schemas of third-party viewers.
//!
//! Input: messages in their bus format, as bytes.
//!
//! Output: bytes in the schema of the channel.
//!
//! Time: [`Stamps`] defines the clock of each timestamp.
//!
//! Failure: bytes that are not a message of the topic yield `None`.

use attitude::frames::{Frame, QuaternionOrder};
use graph::Topic;
use messages::{AttitudeOutput, GnssFix};

use crate::{Payload, viewer};

/// World frame in the viewers: east, north, up. If the course does not refer to true north, the
/// north of this frame is the reference direction of the course.
const WORLD_FRAME: &str = "world";
/// Body frame in the viewers: forward, left, up.
const BODY_FRAME: &str = "body";
/// Channel that offers the attitude as a transform between two frames.
const TF_CHANNEL: &str = "/tf";
/// Channel that offers the attitude as a pose.
const POSE_CHANNEL: &str = "/pose";
/// Channel that offers the position of the satellite receiver.
const LOCATION_CHANNEL: &str = "/location";

/// Viewer channels: name, schema, and the topic they are derived from.
const VIEWER_CHANNELS: [(&str, &str, Topic); 3] = [
    (TF_CHANNEL, viewer::FRAME_TRANSFORM, Topic::Attitude),
    (POSE_CHANNEL, viewer::POSE_IN_FRAME, Topic::Attitude),
    (LOCATION_CHANNEL, viewer::LOCATION_FIX, Topic::Gnss),
];

/// Channel of a flight recording or viewer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Name of the channel: `/<topic>`, or the name of a viewer channel.
    pub name: String,
    /// Fully qualified name of the schema, as accepted by
    /// [`descriptors_for`](crate::schema::descriptors_for).
    pub schema: String,
    /// Topic that the channel is derived from.
    pub topic: Topic,
    /// `true` if the channel carries the output of [`encode_for_viewers`] instead of the topic's
    /// messages.
    pub is_for_viewers: bool,
}

/// Returns the channels of the given topics, followed by the viewer channels derived from them.
pub fn channels(topics: &[Topic]) -> Vec<Channel> {
    let own = topics.iter().map(|topic| Channel {
        name: format!("/{}", topic.name()),
        schema: format!("plumbline.v1.{}", topic.entry().payload),
        topic: *topic,
        is_for_viewers: false,
    });
    let for_viewers = VIEWER_CHANNELS.into_iter().filter(|(_, _, topic)| topics.contains(topic));
    let for_viewers = for_viewers.map(|(name, schema, topic)| Channel {
        name: name.into(),
        schema: schema.into(),
        topic,
        is_for_viewers: true,
    });
    own.chain(for_viewers).collect()
}

/// Byte offsets of `tick`, `t_sent_ns` and `lost_upstream` in a topic's messages; `None` for an
/// absent field.
#[derive(Debug, Clone, Copy)]
pub struct FieldOffsets {
    /// Offset of the field that holds the tick.
    pub tick: Option<usize>,
    t_sent_ns: Option<usize>,
    /// Offset of the field that counts the ticks missing from the stream.
    pub lost_upstream: Option<usize>,
}

/// Timestamps and sequence number of a message on a channel.
///
/// `log_ns` is the time of publication on CLOCK_REALTIME: the message's `t_sent_ns`, or the time of
/// reception if the message has none. This time is converted from CLOCK_MONOTONIC with an offset
/// that is measured only once. `log_ns` therefore never jumps, even if CLOCK_REALTIME is set.
///
/// `source_ns` is the end of the sample's interval on the source's clock, or `log_ns` if the
/// message has no source time.
///
/// `sequence` is the tick, or the number of the message on its channel if the message has no tick.
/// Both are modulo 2³².
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// Time of publication, CLOCK_REALTIME, ns.
    pub log_ns: u64,
    /// Time on the source's clock, ns.
    pub source_ns: u64,
    /// Tick or message number, modulo 2³².
    pub sequence: u32,
}

/// Encoder of a topic's messages for its channel.
#[derive(Debug)]
pub struct Encoder {
    offsets: FieldOffsets,
    encode: fn(&[u8]) -> Option<Encoded>,
    count: u32,
}

/// Encoded message and its time in ns on the source's clock, or `None` if the message has no source
/// time.
type Encoded = (Vec<u8>, Option<i64>);

impl FieldOffsets {
    /// Looks up the offsets in the layout of a topic.
    pub fn new(topic: Topic) -> Self {
        let layout = messages::layout(topic);
        let offset_of = |name: &str| {
            let found = layout.fields.iter().find(|field| field.name == name && field.kind == "u64");
            found.map(|field| field.offset)
        };
        Self { tick: offset_of("tick"), t_sent_ns: offset_of("t_sent_ns"), lost_upstream: offset_of("lost_upstream") }
    }
}

impl Encoder {
    /// Creates an encoder for a topic.
    pub fn new(topic: Topic) -> Self {
        Self {
            offsets: FieldOffsets::new(topic),
            encode: messages::dispatch!(topic, M => encode_message::<M>),
            count: 0,
        }
    }

    /// Returns the publication time of a message on CLOCK_MONOTONIC, ns. Returns `received_ns` if
    /// the message has no publication time.
    pub fn sent_ns(&self, bytes: &[u8], received_ns: u64) -> u64 {
        let sent_ns = self.offsets.t_sent_ns.and_then(|offset| read_u64(bytes, offset));
        sent_ns.filter(|sent_ns| *sent_ns > 0).unwrap_or(received_ns)
    }

    /// Encodes a message that was received at `received_ns`, CLOCK_MONOTONIC.
    ///
    /// `offset_ns` is CLOCK_REALTIME minus CLOCK_MONOTONIC, measured once at the start.
    ///
    /// Returns `None` if the bytes are not a message of the topic.
    pub fn encode(&mut self, bytes: &[u8], received_ns: u64, offset_ns: i64) -> Option<(Vec<u8>, Stamps)> {
        let (data, source_ns) = (self.encode)(bytes)?;
        let log_ns = self.sent_ns(bytes, received_ns).saturating_add_signed(offset_ns);
        let source_ns = source_ns.map_or(log_ns, |source_ns| u64::try_from(source_ns).unwrap_or(0));
        let tick = self.offsets.tick.and_then(|offset| read_u64(bytes, offset));
        let sequence = tick.map_or(self.count, |tick| tick as u32);
        self.count = self.count.wrapping_add(1);
        Some((data, Stamps { log_ns, source_ns, sequence }))
    }
}

/// Encodes a bus message for a viewer channel, with the publication time `log_ns` on
/// CLOCK_REALTIME.
///
/// Returns `None` if the channel is unknown, the bytes are not a message of its topic, or the fix
/// has no position.
pub fn encode_for_viewers(channel: &str, message: &[u8], log_ns: u64) -> Option<Vec<u8>> {
    let xyzw = || {
        let attitude: AttitudeOutput = bytemuck::try_pod_read_unaligned(message).ok()?;
        Some(QuaternionOrder::Xyzw.ordered(Frame::EnuFlu.quaternion(attitude.quaternion)))
    };
    match channel {
        TF_CHANNEL => Some(viewer::frame_transform(log_ns, WORLD_FRAME, BODY_FRAME, xyzw()?)),
        POSE_CHANNEL => Some(viewer::pose_in_frame(log_ns, WORLD_FRAME, xyzw()?)),
        LOCATION_CHANNEL => {
            let fix: GnssFix = bytemuck::try_pod_read_unaligned(message).ok()?;
            let position = [fix.latitude_rad.to_degrees(), fix.longitude_rad.to_degrees(), fix.altitude_m];
            let is_known = position[..2].iter().all(|degrees| degrees.is_finite());
            is_known.then(|| viewer::location_fix(log_ns, BODY_FRAME, position))
        }
        _ => None,
    }
}

/// Reads a native-endian 64-bit number at an offset of a bus message.
pub fn read_u64(bytes: &[u8], offset: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(offset..offset + 8)?.try_into().ok()?))
}

fn encode_message<M: Payload>(bytes: &[u8]) -> Option<Encoded> {
    let message: M = bytemuck::try_pod_read_unaligned(bytes).ok()?;
    Some((message.to_bytes(), message.source_time_ns()))
}

#[cfg(test)]
mod tests {
    use messages::{Health, ImuSample};

    use super::*;

    #[test]
    fn location_fix_without_position_is_omitted() {
        let mut fix: GnssFix = bytemuck::Zeroable::zeroed();
        (fix.latitude_rad, fix.longitude_rad, fix.altitude_m) = (0.5, -1.0, f64::NAN);
        assert!(encode_for_viewers(LOCATION_CHANNEL, bytemuck::bytes_of(&fix), 7).is_some());
        fix.longitude_rad = f64::NAN;
        assert!(encode_for_viewers(LOCATION_CHANNEL, bytemuck::bytes_of(&fix), 7).is_none());
    }

    const OFFSET_NS: i64 = 1_000_000;

    #[test]
    fn sample_has_publication_time_source_time_and_tick() {
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        (sample.header.tick, sample.header.t_sent_ns) = ((1 << 32) + 7, 42);
        (sample.header.t_start_ns, sample.header.t_end_ns) = (-10, -5);
        sample.force_m_s2 = [0.0, 0.5, 9.81];
        let (data, stamps) =
            Encoder::new(Topic::Imu).encode(bytemuck::bytes_of(&sample), 99, OFFSET_NS).expect("a sample");
        assert_eq!(stamps, Stamps { log_ns: 1_000_042, source_ns: 0, sequence: 7 });
        assert_eq!(ImuSample::from_bytes(&data).unwrap(), sample);
    }

    #[test]
    fn unstamped_message_uses_reception_time_and_count() {
        let health: Health = bytemuck::Zeroable::zeroed();
        let mut encoder = Encoder::new(Topic::Health);
        for sequence in 0..3 {
            let (_, stamps) = encoder.encode(bytemuck::bytes_of(&health), 7, OFFSET_NS).expect("a message");
            assert_eq!(stamps, Stamps { log_ns: 1_000_007, source_ns: 1_000_007, sequence });
        }
        assert!(encoder.encode(&[0; 3], 7, OFFSET_NS).is_none());
    }
}
