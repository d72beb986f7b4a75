//! `plumb bridge ros`: publishes `sensor_msgs/msg/Imu` over Zenoh.

use std::{
    process::ExitCode,
    time::{SystemTime, UNIX_EPOCH},
};

use bridges::{
    ros::{MessageType, Node, attachment, encode_imu, parse_frame_id, parse_topic_name},
    validity::{self, WithholdReason},
};
use clap::Args;
use launch::TopicRate;
use link::{Link, Liveliness, MessagePublisher};
use messages::{AttitudeOutput, ImuSample};
use runtime::{clock::monotonic_ns, decimator::Decimator};

use super::sender::{AttitudeSender, BridgeArgs, BridgeError, Inputs, SendCounts, print_counts, rate_hz};
use crate::system::EndpointArgs;

/// Largest ROS 2 domain id.
pub(super) const MAX_DOMAIN: i64 = 232;

/// Arguments of `plumb bridge ros`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb bridge ros                            # to the rmw_zenoh router on this machine
  plumb bridge ros --domain 7 --topic imu/data --frame-id imu_link --rate-hz 50
  plumb bridge ros --connect tcp/192.168.1.5:7447 --for 10s

See docs/how-to/bridges.md.")]
pub(crate) struct Ros {
    #[command(flatten)]
    args: BridgeArgs,
    #[command(flatten)]
    endpoint: EndpointArgs,
    /// ROS_DOMAIN_ID, 0 to 232
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=MAX_DOMAIN))]
    domain: u8,
    /// Topic to publish
    #[arg(long, default_value = "imu/data", value_parser = parse_topic_name)]
    topic: String,
    /// Frame id of the messages: body axes forward, left, up
    #[arg(long, value_name = "NAME", default_value = "imu_link", value_parser = parse_frame_id)]
    frame_id: String,
    /// Messages per second of source time, Hz, 0.1 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = rate_hz)]
    rate_hz: f64,
}

pub(super) fn run(ros: &Ros) -> ExitCode {
    print_counts(ros.run(), ros.args.system.json)
}

impl Ros {
    fn run(&self) -> Result<SendCounts, BridgeError> {
        let observer = self.args.attach()?;
        let link = self.endpoint.endpoint().open_as_client()?;
        let mut publisher = RosPublisher::open(self, &link)?;
        let result = self.args.forward(&observer, Inputs { samples: true, ..Inputs::default() }, &mut publisher);
        let counts = publisher.counts;
        link.close();
        result.map(|()| counts)
    }
}

/// ROS 2 node with one publisher.
struct RosPublisher {
    publisher: MessagePublisher,
    identity: [u8; 16],
    frame_id: String,
    decimator: Decimator,
    _signs: [Liveliness; 2],
    counts: SendCounts,
}

impl RosPublisher {
    fn open(ros: &Ros, link: &Link) -> Result<Self, BridgeError> {
        let (session, identity) = link.identity();
        let node = Node::new(ros.domain, &session);
        let publisher = link.raw_publisher(&node.topic_key(&ros.topic, MessageType::Imu))?;
        Ok(Self {
            publisher,
            identity,
            frame_id: ros.frame_id.clone(),
            decimator: Decimator::new(TopicRate::Hz(ros.rate_hz)),
            _signs: [
                link.declare_liveliness(&node.node_token())?,
                link.declare_liveliness(&node.publisher_token(&ros.topic, MessageType::Imu))?,
            ],
            counts: SendCounts::default(),
        })
    }
}

impl AttitudeSender for RosPublisher {
    fn send(&mut self, output: &AttitudeOutput, sample: Option<&ImuSample>) {
        if !self.decimator.accept(output.header.t_end_ns) {
            return;
        }
        let now_ns = monotonic_ns();
        if let Err(why) = validity::validate(output, now_ns) {
            return self.counts.withhold(why);
        }
        let sent_ns = unix_ns();
        let stamp_ns = sent_ns - now_ns.saturating_sub(output.header.t_born_ns).cast_signed();
        let valid_sample = sample.filter(|sample| sample.force_m_s2.iter().all(|part| part.is_finite()));
        let Some(Ok(bytes)) = valid_sample.map(|sample| encode_imu(output, sample, stamp_ns, &self.frame_id)) else {
            return self.counts.withhold(WithholdReason::Invalid);
        };
        self.counts.attitudes += 1;
        let attachment_bytes = attachment(self.counts.attitudes.cast_signed(), sent_ns, self.identity);
        self.counts.dropped += u64::from(self.publisher.send_with_attachment(bytes, attachment_bytes).is_err());
    }

    fn poll(&mut self) {}
}

/// Returns the current time on CLOCK_REALTIME, ns.
fn unix_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
