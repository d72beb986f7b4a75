//! A topic's message as protobuf, with its times.

use attitude::frames::{Frame, QuaternionOrder};
use graph::{Presence, Topic};
use messages::{AttitudeOutput, GnssFix};
use wire::{Payload, viewer};

/// The frame in which viewers see the attitude: east, north, up where the course is true, else turned about the vertical.
pub(crate) const WORLD: &str = "world";
/// The body's frame there: forward, left, up.
pub(crate) const BODY: &str = "body";
/// The attitude as a frame that turns in another.
pub(crate) const TF: &str = "/tf";
/// The attitude as a pose.
pub(crate) const POSE: &str = "/pose";
/// Where the body is.
pub(crate) const LOCATION: &str = "/location";

/// What is recorded for viewers: a channel, its schema, and the topic that it is made of.
pub(crate) const FOR_VIEWERS: [(&str, &str, Topic); 3] = [
    (TF, viewer::FRAME_TRANSFORM, Topic::Attitude),
    (POSE, viewer::POSE_IN_FRAME, Topic::Attitude),
    (LOCATION, viewer::LOCATION_FIX, Topic::Gnss),
];

/// What messages of a topic say of themselves: where the numbers stand that tell their place in time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fields {
    pub(crate) tick: Option<usize>,
    t_sent_ns: Option<usize>,
    pub(crate) lost_upstream: Option<usize>,
}

/// The times of a message in a flight.
///
/// `log_time` is when it was published on CLOCK_REALTIME: the stamp `t_sent_ns` of CLOCK_MONOTONIC, or for messages without one the time
/// at which the recorder took it, moved by the difference that the clocks had when the recording began. So it never leaps, not even when
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

/// A topic's messages on their way into a file.
pub(crate) struct Encoder {
    pub(crate) topic: Topic,
    fields: Fields,
    encode: fn(&[u8], f64) -> Option<Encoded>,
    count: u32,
}

/// A message as protobuf, and its time on the source's clock, ns, where it has one.
type Encoded = (Vec<u8>, Option<i64>);

/// Clocks of a recording.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clocks {
    /// CLOCK_REALTIME less CLOCK_MONOTONIC when it began, ns.
    pub(crate) offset_ns: i64,
    /// Ticks per second of the source's time.
    pub(crate) rate_hz: f64,
}

impl Fields {
    pub(crate) fn of(topic: Topic) -> Self {
        let layout = messages::layout(topic);
        let at = |name: &str| {
            let found = layout.fields.iter().find(|field| field.name == name && field.kind == "u64");
            found.map(|field| field.offset)
        };
        Self { tick: at("tick"), t_sent_ns: at("t_sent_ns"), lost_upstream: at("lost_upstream") }
    }
}

impl Encoder {
    pub(crate) fn new(topic: Topic) -> Self {
        Self { topic, fields: Fields::of(topic), encode: messages::dispatch!(topic, M => encoded::<M>), count: 0 }
    }

    /// The name of the topic's channel.
    pub(crate) fn name(topic: Topic) -> String {
        format!("/{}", topic.name())
    }

    /// The name of the topic's schema.
    pub(crate) fn schema(topic: Topic) -> String {
        format!("plumbline.v1.{}", topic.entry().payload)
    }

    /// A message that the recorder took at `taken_ns`, CLOCK_MONOTONIC; `None` where the bytes are none.
    pub(crate) fn encode(&mut self, bytes: &[u8], taken_ns: u64, clocks: Clocks) -> Option<(Vec<u8>, Stamps)> {
        let (data, source_ns) = (self.encode)(bytes, clocks.rate_hz)?;
        let Fields { tick, t_sent_ns, .. } = self.fields;
        let sent_ns = t_sent_ns.and_then(|at| number(bytes, at)).filter(|sent_ns| *sent_ns > 0).unwrap_or(taken_ns);
        let log_ns = sent_ns.saturating_add_signed(clocks.offset_ns);
        let source_ns = source_ns.map_or(log_ns, |source_ns| u64::try_from(source_ns).unwrap_or(0));
        let sequence = tick.and_then(|at| number(bytes, at)).map_or(self.count, |tick| tick as u32);
        self.count = self.count.wrapping_add(1);
        Some((data, Stamps { log_ns, source_ns, sequence }))
    }
}

/// What the channel of [`FOR_VIEWERS`] has of a message of its topic; `None` where that tells nothing of it.
pub(crate) fn for_viewers(channel: &str, message: &[u8], log_ns: u64) -> Option<Vec<u8>> {
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
pub(crate) fn number(bytes: &[u8], offset: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(offset..offset + 8)?.try_into().ok()?))
}

/// Every tick is expected on the topic.
pub(crate) fn has_every_tick(topic: Topic) -> bool {
    topic.entry().presence == Presence::EveryTick
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
