//! `plumb bridge ros-sensor`: feeds readings from ROS 2 topics to a running system.

use std::{fmt, time::Duration};

use bridges::ros::{MessageType, Node, parse_topic_name};
use clap::Args;
use driver::{DriverError, Sensor};
use import::ros_messages::{self, Imu};
use serde::Serialize;

use super::{
    ros::{MAX_DOMAIN, open_router_link},
    sender::{AttachedSystem, BridgeArgs},
};
use crate::{
    failure::{Failure, Outcome},
    stdout::print_result,
    system::EndpointArgs,
    topics::StopCondition,
};

/// Longest wait for a message before the stop condition is checked.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(100);
/// Maximum number of magnetic fields received per reading, so that a flood of them does not delay
/// the reading.
const MAX_FIELDS: usize = 1000;

/// Arguments of `plumb bridge ros-sensor`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb bridge ros-sensor
  plumb bridge ros-sensor --topic imu/data_raw --mag imu/mag --for 1h

The launch file of the system needs source = \"bus\" in [ingest] (docs/how-to/bridges.md).")]
pub(crate) struct RosSensor {
    #[command(flatten)]
    args: BridgeArgs,
    #[command(flatten)]
    endpoint: EndpointArgs,
    /// ROS_DOMAIN_ID, 0 to 232
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=MAX_DOMAIN))]
    domain: u8,
    /// Topic with rate and force (sensor_msgs/msg/Imu)
    #[arg(long, default_value = "imu/data_raw", value_parser = parse_topic_name)]
    topic: String,
    /// Magnetic field topic (sensor_msgs/msg/MagneticField) [default: none]
    #[arg(long, value_name = "TOPIC", value_parser = parse_topic_name)]
    mag: Option<String>,
}

/// Counts of received messages.
#[derive(Debug, Default, Serialize)]
pub(super) struct SensorCounts {
    /// Number of readings forwarded to the system.
    readings: u64,
    /// Number of forwarded readings that include a magnetic field.
    fields: u64,
    /// Number of messages that were malformed, contained a non-finite number, or lacked rate or
    /// force.
    rejected: u64,
    /// Number of readings that arrived while the system was not accepting any.
    undelivered: u64,
}

pub(super) fn run(sensor: &RosSensor) -> Outcome {
    Ok(print_result(&sensor.forward()?, sensor.args.system.json))
}

impl RosSensor {
    fn forward(&self) -> Result<SensorCounts, Failure> {
        let AttachedSystem { name, observer } = self.args.attach()?;
        // Fails immediately if the system does not receive its readings from the bus.
        let mut sensor = Sensor::open(&name)?;
        let link = open_router_link(&self.endpoint)?;
        let node = Node::new(self.domain, &link.identity().0);
        let imu = link.subscribe(&node.topic_key_any_hash(&self.topic, MessageType::Imu))?;
        let mag = self
            .mag
            .as_ref()
            .map(|topic| link.subscribe(&node.topic_key_any_hash(topic, MessageType::MagneticField)))
            .transpose()?;
        let mut tokens = vec![
            link.declare_liveliness(&node.node_token())?,
            link.declare_liveliness(&node.subscription_token(1, &self.topic, MessageType::Imu))?,
        ];
        if let Some(topic) = &self.mag {
            tokens.push(link.declare_liveliness(&node.subscription_token(2, topic, MessageType::MagneticField))?);
        }
        let mut counts = SensorCounts::default();
        let mut stop = StopCondition::new(|| observer.is_running(), self.args.duration);
        while !stop.is_met() {
            let Some(arrival) = imu.next(RECEIVE_TIMEOUT).filter(|arrival| arrival.is_present) else { continue };
            // The newest magnetic field is forwarded once, with the next reading.
            let mut field_ut = None;
            for _ in 0..MAX_FIELDS {
                let Some(arrival) = mag.as_ref().and_then(|mag| mag.next(Duration::ZERO)) else { break };
                let read = ros_messages::field_ut(&arrival.bytes);
                counts.rejected += u64::from(read.is_none());
                field_ut = read.or(field_ut);
            }
            let Some(Imu { t_ns, rate_rad_s, force_m_s2 }) = ros_messages::imu(&arrival.bytes) else {
                counts.rejected += 1;
                continue;
            };
            match sensor.send(t_ns, rate_rad_s, force_m_s2, field_ut) {
                Ok(()) => {
                    counts.readings += 1;
                    counts.fields += u64::from(field_ut.is_some());
                }
                Err(DriverError::Bus(_) | DriverError::TopicNotOpen { .. }) => counts.undelivered += 1,
            }
        }
        drop(tokens);
        link.close();
        Ok(counts)
    }
}

impl fmt::Display for SensorCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { readings, fields, rejected, undelivered } = self;
        write!(f, "{readings} readings passed on, {fields} with a magnetic field")?;
        if *rejected > 0 {
            write!(f, "; {rejected} messages rejected")?;
        }
        if *undelivered > 0 {
            write!(f, "; {undelivered} readings not accepted by the system")?;
        }
        Ok(())
    }
}
