//! `plumb bridge ros`: publishes attitude, transform, magnetic field and diagnostics over Zenoh.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bridges::{
    diagnostics::{AttitudeMonitor, service_status, silent_supervisor_status},
    ros::{MessageType, Node, attachment, parse_frame_id, parse_topic_name, publisher_gid},
    ros_messages::{encode_diagnostics, encode_imu, encode_magnetic_field, encode_transform},
    validity::{self, WithholdReason},
};
use clap::Args;
use launch::TopicRate;
use link::{Link, LinkError, Liveliness, MessagePublisher};
use messages::{AttitudeOutput, Header, ImuSample, MagSample};
use runtime::{clock::monotonic_ns, decimator::Decimator};

use super::{
    sender::{AttitudeSender, BridgeArgs, Inputs, SendCounts, rate_hz},
    status_poller::StatusPoller,
};
use crate::{
    failure::{Failure, Outcome},
    remote::RemoteError,
    stdout::print_result,
    system::EndpointArgs,
};

/// Largest ROS 2 domain id.
pub(super) const MAX_DOMAIN: i64 = 232;
/// Topics on which ROS 2 expects transforms and diagnostics.
const TRANSFORM_TOPIC: &str = "tf";
const DIAGNOSTICS_TOPIC: &str = "diagnostics";
/// Command that starts an rmw_zenoh router.
const START_ROUTER: &str = "start it with `ros2 run rmw_zenoh_cpp rmw_zenohd`";
/// Interval between two diagnostic messages, and between two checks of the router.
const DIAGNOSTICS_INTERVAL: Duration = Duration::from_secs(1);

/// Arguments of `plumb bridge ros`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb bridge ros                # to the rmw_zenoh router on this machine
  plumb bridge ros --domain 7 --parent-frame-id odom --frame-id imu_link
  plumb bridge ros --connect tcp/192.168.1.5:7447 --no-tf --for 10s

Publishes Imu, MagneticField, /tf and /diagnostics. Start the router first:
`ros2 run rmw_zenoh_cpp rmw_zenohd` (docs/how-to/bridges.md).")]
pub(crate) struct Ros {
    #[command(flatten)]
    args: BridgeArgs,
    #[command(flatten)]
    endpoint: EndpointArgs,
    /// ROS_DOMAIN_ID, 0 to 232
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=MAX_DOMAIN))]
    domain: u8,
    /// Topic of the attitude (sensor_msgs/msg/Imu)
    #[arg(long, default_value = "imu/data", value_parser = parse_topic_name)]
    topic: String,
    /// Topic of the magnetic field (sensor_msgs/msg/MagneticField)
    #[arg(long, value_name = "TOPIC", default_value = "imu/mag", value_parser = parse_topic_name)]
    mag_topic: String,
    /// Frame id of the body (child in /tf), with axes forward, left, up
    #[arg(long, value_name = "NAME", default_value = "imu_link", value_parser = parse_frame_id)]
    frame_id: String,
    /// Frame id of the parent in /tf, with axes east, north, up
    #[arg(long, value_name = "NAME", default_value = "map", value_parser = parse_frame_id)]
    parent_frame_id: String,
    /// Do not publish /tf (if another node publishes the body frame)
    #[arg(long)]
    no_tf: bool,
    /// Messages per second of source time, Hz, 0.1 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = rate_hz)]
    rate_hz: f64,
}

pub(super) fn run(ros: &Ros) -> Outcome {
    let system = ros.args.attach()?;
    let link = open_router_link(&ros.endpoint)?;
    let mut publisher = RosPublisher::open(ros, &system.name, &link)?;
    let inputs = Inputs { samples: true, fields: true, ..Inputs::default() };
    let result = ros.args.forward(&system, inputs, &mut publisher);
    link.close();
    result.map(|()| print_result(&publisher.counts, ros.args.system.json))
}

/// Opens a session with an rmw_zenoh router. Without a router, ROS 2 nodes do not discover each
/// other.
pub(super) fn open_router_link(endpoint: &EndpointArgs) -> Result<Link, Failure> {
    let endpoint = endpoint.endpoint();
    let link = endpoint.open_as_client().map_err(|error| match error {
        RemoteError::Link(cause @ LinkError::Unreachable { .. }) => {
            let remedy = "or set its endpoint with --connect";
            Failure::new(format_args!("no rmw_zenoh router: {cause}\n{START_ROUTER}, {remedy}"), 1)
        }
        error => error.into(),
    })?;
    if !link.has_router() {
        link.close();
        let reason = format!("{endpoint} is not a router, but for instance the gateway of a system");
        let remedy = format!("{START_ROUTER} before `plumb up`, or set its endpoint with --connect");
        return Err(Failure::new(format_args!("no rmw_zenoh router: {reason}\n{remedy}"), 1));
    }
    Ok(link)
}

/// Publisher of one topic.
struct TopicPublisher {
    publisher: MessagePublisher,
    gid: [u8; 16],
    /// Number of messages sent.
    sequence_number: i64,
    _sign: Liveliness,
}

impl TopicPublisher {
    fn open(link: &Link, node: &Node, entity_id: u32, topic: &str, of_type: MessageType) -> Result<Self, LinkError> {
        Ok(Self {
            publisher: link.raw_publisher(&node.topic_key(topic, of_type))?,
            gid: publisher_gid(link.identity().1, entity_id),
            sequence_number: 0,
            _sign: link.declare_liveliness(&node.publisher_token(entity_id, topic, of_type))?,
        })
    }

    /// Sends a message. Returns `true` if the network accepted it.
    fn send(&mut self, bytes: Vec<u8>, sent_ns: i64) -> bool {
        self.sequence_number += 1;
        let attachment_bytes = attachment(self.sequence_number, sent_ns, self.gid);
        self.publisher.send_with_attachment(bytes, attachment_bytes).is_ok()
    }
}

/// ROS 2 node with its publishers.
struct RosPublisher {
    imu: TopicPublisher,
    mag: TopicPublisher,
    transforms: Option<TopicPublisher>,
    diagnostics: TopicPublisher,
    frame_id: String,
    parent_frame_id: String,
    system: String,
    decimator: Decimator,
    field_decimator: Decimator,
    monitor: AttitudeMonitor,
    services: StatusPoller,
    diagnosed: Instant,
    link: Link,
    has_router: bool,
    _sign: Liveliness,
    counts: SendCounts,
}

impl RosPublisher {
    fn open(ros: &Ros, system: &str, link: &Link) -> Result<Self, Failure> {
        let node = Node::new(ros.domain, &link.identity().0);
        let sign = link.declare_liveliness(&node.node_token())?;
        let open = |entity_id, topic: &str, of_type| TopicPublisher::open(link, &node, entity_id, topic, of_type);
        let decimator = Decimator::new(TopicRate::Hz(ros.rate_hz));
        Ok(Self {
            imu: open(1, &ros.topic, MessageType::Imu)?,
            mag: open(2, &ros.mag_topic, MessageType::MagneticField)?,
            transforms: (!ros.no_tf).then(|| open(3, TRANSFORM_TOPIC, MessageType::TfMessage)).transpose()?,
            diagnostics: open(4, DIAGNOSTICS_TOPIC, MessageType::DiagnosticArray)?,
            frame_id: ros.frame_id.clone(),
            parent_frame_id: ros.parent_frame_id.clone(),
            decimator: decimator.clone(),
            field_decimator: decimator,
            monitor: AttitudeMonitor::default(),
            services: StatusPoller::start(system),
            diagnosed: Instant::now(),
            system: system.into(),
            link: link.clone(),
            has_router: true,
            _sign: sign,
            counts: SendCounts { fields: Some(0), diagnostics: Some(0), ..SendCounts::default() },
        })
    }

    /// Announces once that the router is missing, and once that it is back.
    fn check_router(&mut self) {
        let has_router = self.link.has_router();
        if has_router != self.has_router {
            self.has_router = has_router;
            if has_router {
                supervisor::announce("connected to the rmw_zenoh router again");
            } else {
                supervisor::announce(format_args!("lost the rmw_zenoh router: messages reach no node; {START_ROUTER}"));
            }
        }
    }
}

impl AttitudeSender for RosPublisher {
    fn send(&mut self, output: &AttitudeOutput, sample: Option<&ImuSample>) {
        self.monitor.record(output);
        if !self.decimator.accept(output.header.t_end_ns) {
            return;
        }
        let now_ns = monotonic_ns();
        if let Err(why) = validity::validate(output, now_ns) {
            return self.counts.withhold(why);
        }
        let (sent_ns, stamp_ns) = times(&output.header, now_ns);
        let valid_sample = sample.filter(|sample| sample.force_m_s2.iter().all(|part| part.is_finite()));
        let imu = valid_sample.and_then(|sample| encode_imu(output, sample, stamp_ns, &self.frame_id).ok());
        let transform = encode_transform(output, stamp_ns, &self.parent_frame_id, &self.frame_id).ok();
        let Some((imu, transform)) = imu.zip(transform) else {
            return self.counts.withhold(WithholdReason::Invalid);
        };
        self.counts.attitudes += 1;
        self.counts.dropped += u64::from(!self.imu.send(imu, sent_ns));
        if let Some(transforms) = &mut self.transforms {
            self.counts.dropped += u64::from(!transforms.send(transform, sent_ns));
        }
    }

    fn send_field(&mut self, field: &MagSample) {
        if !self.field_decimator.accept(field.header.t_end_ns) {
            return;
        }
        let now_ns = monotonic_ns();
        if let Err(why) = validity::check_age(&field.header, now_ns) {
            return self.counts.withhold(why);
        }
        let (sent_ns, stamp_ns) = times(&field.header, now_ns);
        let Ok(bytes) = encode_magnetic_field(field, stamp_ns, &self.frame_id) else {
            return self.counts.withhold(WithholdReason::Invalid);
        };
        self.counts.fields.iter_mut().for_each(|fields| *fields += 1);
        self.counts.dropped += u64::from(!self.mag.send(bytes, sent_ns));
    }

    /// Sends a diagnostic message if one is due.
    fn poll(&mut self) {
        if self.diagnosed.elapsed() < DIAGNOSTICS_INTERVAL {
            return;
        }
        self.diagnosed = Instant::now();
        self.check_router();
        let mut statuses = vec![self.monitor.report(monotonic_ns())];
        match self.services.newest() {
            Some(Ok(services)) => statuses.extend(services.iter().map(service_status)),
            Some(Err(cause)) => statuses.push(silent_supervisor_status(&cause)),
            None => {}
        }
        let sent_ns = unix_ns();
        let bytes = encode_diagnostics(&statuses, sent_ns, &self.system).ok();
        self.counts.diagnostics.iter_mut().for_each(|diagnostics| *diagnostics += 1);
        self.counts.dropped += u64::from(!bytes.is_some_and(|bytes| self.diagnostics.send(bytes, sent_ns)));
    }
}

/// Returns the current time and the time of the sample, both on CLOCK_REALTIME, ns.
fn times(header: &Header, now_ns: u64) -> (i64, i64) {
    let sent_ns = unix_ns();
    (sent_ns, sent_ns - now_ns.saturating_sub(header.t_born_ns).cast_signed())
}

/// Returns the current time on CLOCK_REALTIME, ns.
fn unix_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
