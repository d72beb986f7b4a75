//! Topics as channels of flights and viewers: each message as protobuf with its times, the attitude beside it as viewers know it.
//!
//! Input: messages as bytes of the bus. Output: bytes in the schema of the channel. Time: [`Stamps`] says which clock is which. Failure: bytes
//! that are no message give none.

use attitude::frames::{Frame, QuaternionOrder};
use graph::Topic;
use messages::{AttitudeOutput, GnssFix};

use crate::{Payload, viewer};

/// The frame in which viewers see the attitude: east, north, up where the course is true, else turned about the vertical.
const WORLD: &str = "world";
/// The body's frame there: forward, left, up.
const BODY: &str = "body";
/// The attitude as a frame that turns in another.
const TF: &str = "/tf";
/// The attitude as a pose.
const POSE: &str = "/pose";
/// Where the body is.
const LOCATION: &str = "/location";

/// What is made for viewers: a channel, its schema, and the topic that it is made of.
const FOR_VIEWERS: [(&str, &str, Topic); 3] = [
    (TF, viewer::FRAME_TRANSFORM, Topic::Attitude),
    (POSE, viewer::POSE_IN_FRAME, Topic::Attitude),
    (LOCATION, viewer::LOCATION_FIX, Topic::Gnss),
];

/// A channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub name: String,
    /// The name of its schema, which [`descriptors_of`](crate::schema::descriptors_of) knows.
    pub schema: String,
    /// The topic that it is made of.
    pub topic: Topic,
    /// It has what [`for_viewers`] makes of the topic's messages, not these themselves.
    pub is_for_viewers: bool,
}

/// The channels of these topics: their own, then those for viewers.
pub fn channels(topics: &[Topic]) -> Vec<Channel> {
    let own = topics.iter().map(|topic| Channel {
        name: format!("/{}", topic.name()),
        schema: format!("plumbline.v1.{}", topic.entry().payload),
        topic: *topic,
        is_for_viewers: false,
    });
    let made = FOR_VIEWERS.into_iter().filter(|(_, _, topic)| topics.contains(topic));
    let made = made.map(|(name, schema, topic)| Channel {
        name: name.into(),
        schema: schema.into(),
        topic,
        is_for_viewers: true,
    });
    own.chain(made).collect()
}

/// What messages of a topic say of themselves: where the numbers stand that tell their place in time.
#[derive(Debug, Clone, Copy)]
pub struct Fields {
    /// The tick.
    pub tick: Option<usize>,
    t_sent_ns: Option<usize>,
    /// The ticks that the publisher never had.
    pub lost_upstream: Option<usize>,
}

/// The times of a message on a channel.
///
/// `log_time` is when it was published on CLOCK_REALTIME: the stamp `t_sent_ns` of CLOCK_MONOTONIC, or for messages without one the time
/// at which it was taken, moved by the difference that the clocks had at the beginning. So it never leaps, not even when
/// the clock is set. `publish_time` is the end of the sample's interval on the source's clock, and where a message has none, the same as
/// `log_time`. `sequence` is the tick, and where there is none the number of the message on its channel; both modulo 2³².
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// Publication on CLOCK_REALTIME, ns.
    pub log_ns: u64,
    /// The source's time, ns.
    pub source_ns: u64,
    /// The tick or the number of the message.
    pub sequence: u32,
}

/// A topic's messages on their way to its channel.
#[derive(Debug)]
pub struct Encoder {
    fields: Fields,
    encode: fn(&[u8], f64) -> Option<Encoded>,
    count: u32,
}

/// A message as protobuf, and its time on the source's clock, ns, where it has one.
type Encoded = (Vec<u8>, Option<i64>);

/// The clocks of a board.
#[derive(Debug, Clone, Copy)]
pub struct Clocks {
    /// CLOCK_REALTIME less CLOCK_MONOTONIC at the beginning, ns.
    pub offset_ns: i64,
    /// Ticks per second of the source's time.
    pub rate_hz: f64,
}

impl Fields {
    /// Those of a topic.
    pub fn of(topic: Topic) -> Self {
        let layout = messages::layout(topic);
        let at = |name: &str| {
            let found = layout.fields.iter().find(|field| field.name == name && field.kind == "u64");
            found.map(|field| field.offset)
        };
        Self { tick: at("tick"), t_sent_ns: at("t_sent_ns"), lost_upstream: at("lost_upstream") }
    }
}

impl Encoder {
    /// Of a topic.
    pub fn new(topic: Topic) -> Self {
        Self { fields: Fields::of(topic), encode: messages::dispatch!(topic, M => encoded::<M>), count: 0 }
    }

    /// When a message that was taken at `taken_ns` was published, CLOCK_MONOTONIC, ns.
    pub fn sent_ns(&self, bytes: &[u8], taken_ns: u64) -> u64 {
        let sent_ns = self.fields.t_sent_ns.and_then(|at| number(bytes, at));
        sent_ns.filter(|sent_ns| *sent_ns > 0).unwrap_or(taken_ns)
    }

    /// A message that was taken at `taken_ns`, CLOCK_MONOTONIC; `None` where the bytes are none.
    pub fn encode(&mut self, bytes: &[u8], taken_ns: u64, clocks: Clocks) -> Option<(Vec<u8>, Stamps)> {
        let (data, source_ns) = (self.encode)(bytes, clocks.rate_hz)?;
        let log_ns = self.sent_ns(bytes, taken_ns).saturating_add_signed(clocks.offset_ns);
        let source_ns = source_ns.map_or(log_ns, |source_ns| u64::try_from(source_ns).unwrap_or(0));
        let tick = self.fields.tick.and_then(|at| number(bytes, at));
        let sequence = tick.map_or(self.count, |tick| tick as u32);
        self.count = self.count.wrapping_add(1);
        Some((data, Stamps { log_ns, source_ns, sequence }))
    }
}

/// What a channel for viewers has of a message of its topic, published at `log_ns` of CLOCK_REALTIME; `None` where that tells nothing of it.
pub fn for_viewers(channel: &str, message: &[u8], log_ns: u64) -> Option<Vec<u8>> {
    let xyzw = || {
        let attitude: AttitudeOutput = bytemuck::try_pod_read_unaligned(message).ok()?;
        Some(QuaternionOrder::Xyzw.ordered(Frame::EnuFlu.quaternion(attitude.quaternion)))
    };
    match channel {
        TF => Some(viewer::frame_transform(log_ns, WORLD, BODY, xyzw()?)),
        POSE => Some(viewer::pose_in_frame(log_ns, WORLD, xyzw()?)),
        LOCATION => {
            let fix: GnssFix = bytemuck::try_pod_read_unaligned(message).ok()?;
            let place = [fix.latitude_rad.to_degrees(), fix.longitude_rad.to_degrees(), fix.altitude_m];
            let is_known = place[..2].iter().all(|degrees| degrees.is_finite());
            is_known.then(|| viewer::location_fix(log_ns, BODY, place))
        }
        _ => None,
    }
}

/// A number of 64 bits in a message.
pub fn number(bytes: &[u8], offset: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(offset..offset + 8)?.try_into().ok()?))
}

/// `None` where the bytes are no message.
fn encoded<M: Payload>(bytes: &[u8], rate_hz: f64) -> Option<Encoded> {
    let message: M = bytemuck::try_pod_read_unaligned(bytes).ok()?;
    Some((message.encoded(), message.source_time_ns(rate_hz)))
}

#[cfg(test)]
mod tests {
    use messages::{Health, ImuSample};

    use super::*;

    #[test]
    fn a_fix_that_tells_no_place_is_none_on_the_map() {
        let mut fix: GnssFix = bytemuck::Zeroable::zeroed();
        (fix.latitude_rad, fix.longitude_rad, fix.altitude_m) = (0.5, -1.0, f64::NAN);
        assert!(for_viewers(LOCATION, bytemuck::bytes_of(&fix), 7).is_some());
        fix.longitude_rad = f64::NAN;
        assert!(for_viewers(LOCATION, bytemuck::bytes_of(&fix), 7).is_none());
    }

    const CLOCKS: Clocks = Clocks { offset_ns: 1_000_000, rate_hz: 100.0 };

    #[test]
    fn a_sample_has_its_publication_its_sources_time_and_its_tick() {
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        (sample.header.tick, sample.header.t_sent_ns) = ((1 << 32) + 7, 42);
        (sample.header.t_start_ns, sample.header.t_end_ns) = (-10, -5);
        sample.force_m_s2 = [0.0, 0.5, 9.81];
        let (data, stamps) =
            Encoder::new(Topic::Imu).encode(bytemuck::bytes_of(&sample), 99, CLOCKS).expect("a sample");
        assert_eq!(stamps, Stamps { log_ns: 1_000_042, source_ns: 0, sequence: 7 });
        assert_eq!(ImuSample::decoded(&data).unwrap(), sample);
    }

    #[test]
    fn what_has_no_stamps_has_the_recorders_time_and_is_counted() {
        let health: Health = bytemuck::Zeroable::zeroed();
        let mut encoder = Encoder::new(Topic::Health);
        for sequence in 0..3 {
            let (_, stamps) = encoder.encode(bytemuck::bytes_of(&health), 7, CLOCKS).expect("a message");
            assert_eq!(stamps, Stamps { log_ns: 1_000_007, source_ns: 1_000_007, sequence });
        }
        assert!(encoder.encode(&[0; 3], 7, CLOCKS).is_none());
    }
}
