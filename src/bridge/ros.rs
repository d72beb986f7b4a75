//! `plumb bridge ros`: `sensor_msgs/msg/Imu` over Zenoh.

use std::time::{SystemTime, UNIX_EPOCH};

use bridges::{
    ros::{Message, Node, attachment, frame_id, imu, topic_name},
    soundness::{self, Withheld},
};
use clap::Args;
use gateway::decimator::Decimator;
use launch::TopicRate;
use link::{Link, Liveliness, MessagePublisher};
use messages::{AttitudeOutput, ImuSample};
use runtime::clock::monotonic_ns;

use super::{BridgeError, Observed, Sender, Sent, rate_hz};
use crate::remote::Way;

/// The highest number of a domain that ROS 2 allows.
pub(super) const MAX_DOMAIN: i64 = 232;

/// The command line of `plumb bridge ros`.
#[derive(Args)]
pub(crate) struct Ros {
    #[command(flatten)]
    pub(super) observed: Observed,
    #[command(flatten)]
    way: Way,
    /// ROS_DOMAIN_ID.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=MAX_DOMAIN))]
    domain: u8,
    /// The topic.
    #[arg(long, default_value = "imu/data", value_parser = topic_name)]
    topic: String,
    /// `header.frame_id`: the frame of the body, forward, left, up.
    #[arg(long, value_name = "NAME", default_value = "imu_link", value_parser = frame_id)]
    frame_id: String,
    /// Messages a second of the source's time.
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = rate_hz)]
    rate_hz: f64,
}

impl Ros {
    pub(super) fn run(&self) -> Result<Sent, BridgeError> {
        let seat = self.observed.seat()?;
        let link = self.way.open_as_client()?;
        let mut publisher = Publisher::open(self, &link)?;
        let followed = self.observed.follow(&seat, true, &mut publisher);
        let sent = publisher.sent;
        link.close();
        followed.map(|()| sent)
    }
}

/// A node with one publisher.
struct Publisher {
    outlet: MessagePublisher,
    identity: [u8; 16],
    frame_id: String,
    decimator: Decimator,
    _signs: [Liveliness; 2],
    sent: Sent,
}

impl Publisher {
    fn open(ros: &Ros, link: &Link) -> Result<Self, BridgeError> {
        let (session, identity) = link.identity();
        let node = Node::new(ros.domain, &session);
        let outlet = link.raw_publisher(&node.topic_key(&ros.topic, Message::Imu))?;
        Ok(Self {
            outlet,
            identity,
            frame_id: ros.frame_id.clone(),
            decimator: Decimator::new(TopicRate::Hz(ros.rate_hz)),
            _signs: [link.declare_liveliness(&node.sign())?, link.declare_liveliness(&node.publisher_sign(&ros.topic, Message::Imu))?],
            sent: Sent::default(),
        })
    }
}

impl Sender for Publisher {
    fn take(&mut self, output: &AttitudeOutput, sample: Option<&ImuSample>) {
        if !self.decimator.accept(output.header.t_end_ns) {
            return;
        }
        let now_ns = monotonic_ns();
        if let Err(why) = soundness::check(output, now_ns) {
            return self.sent.withhold(why);
        }
        let made_ns = unix_ns();
        let stamp_ns = made_ns - now_ns.saturating_sub(output.header.t_born_ns).cast_signed();
        let finite = sample.filter(|sample| sample.force_m_s2.iter().all(|part| part.is_finite()));
        let Some(Ok(bytes)) = finite.map(|sample| imu(output, sample, stamp_ns, &self.frame_id)) else {
            return self.sent.withhold(Withheld::Invalid);
        };
        self.sent.attitudes += 1;
        let beside = attachment(self.sent.attitudes.cast_signed(), made_ns, self.identity);
        self.sent.dropped += u64::from(self.outlet.send_with_attachment(bytes, beside).is_err());
    }

    fn look(&mut self) {}
}

/// CLOCK_REALTIME, ns.
fn unix_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
