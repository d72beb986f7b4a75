//! `plumb bridge ros-sensor`: readings of ROS topics for a running system.

use std::{fmt, time::Duration};

use bridges::ros::{Message, Node, topic_name};
use clap::Args;
use driver::{DriverError, Sensor};
use import::ros_messages::{self, Imu};
use serde::Serialize;

use super::{BridgeError, Observed, ros::MAX_DOMAIN};
use crate::{remote::Way, seeing::Until};

/// How long a message is waited for before it is seen whether the time is over.
const WAIT: Duration = Duration::from_millis(100);

/// The command line of `plumb bridge ros-sensor`.
#[derive(Args)]
pub(crate) struct RosSensor {
    #[command(flatten)]
    pub(super) observed: Observed,
    #[command(flatten)]
    way: Way,
    /// ROS_DOMAIN_ID.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=MAX_DOMAIN))]
    domain: u8,
    /// The topic with rate and force, sensor_msgs/msg/Imu.
    #[arg(long, default_value = "imu/data_raw", value_parser = topic_name)]
    topic: String,
    /// The topic with the magnetic field, sensor_msgs/msg/MagneticField, as imu/mag [default: none].
    #[arg(long, value_name = "TOPIC", value_parser = topic_name)]
    mag: Option<String>,
}

/// What became of the messages.
#[derive(Debug, Default, Serialize)]
pub(super) struct Taken {
    /// Readings given to the system.
    readings: u64,
    /// Fields that went with them.
    fields: u64,
    /// Messages that were malformed, not finite, or without rate or force.
    refused: u64,
    /// Readings that came while no system took any.
    unheard: u64,
}

impl RosSensor {
    pub(super) fn run(&self) -> Result<Taken, BridgeError> {
        let seat = self.observed.seat()?;
        // It says at once where the system takes no readings.
        let mut sensor = Sensor::open(&self.observed.system.name())?;
        let link = self.way.open_as_client()?;
        let node = Node::new(self.domain, &link.identity().0);
        let imu = link.subscribe(&node.topic_keys(&self.topic, Message::Imu))?;
        let mag =
            self.mag.as_ref().map(|topic| link.subscribe(&node.topic_keys(topic, Message::MagneticField))).transpose()?;
        let mut signs =
            vec![link.declare_liveliness(&node.sign())?, link.declare_liveliness(&node.subscription_sign(1, &self.topic, Message::Imu))?];
        if let Some(topic) = &self.mag {
            signs.push(link.declare_liveliness(&node.subscription_sign(2, topic, Message::MagneticField))?);
        }
        let mut taken = Taken::default();
        let mut until = Until::new(|| seat.is_running(), self.observed.duration_s.map(Duration::from_secs_f64));
        while !until.is_over() {
            let Some(arrival) = imu.next(WAIT).filter(|arrival| arrival.is_present) else { continue };
            // The newest field goes with the next reading, once.
            let mut field_ut = None;
            while let Some(arrival) = mag.as_ref().and_then(|mag| mag.next(Duration::ZERO)) {
                let read = ros_messages::field_ut(&arrival.bytes);
                taken.refused += u64::from(read.is_none());
                field_ut = read.or(field_ut);
            }
            let Some(Imu { t_ns, rate_rad_s, force_m_s2 }) = ros_messages::imu(&arrival.bytes) else {
                taken.refused += 1;
                continue;
            };
            match sensor.send(t_ns, rate_rad_s, force_m_s2, field_ut) {
                Ok(()) => {
                    taken.readings += 1;
                    taken.fields += u64::from(field_ut.is_some());
                }
                Err(DriverError::Bus(_) | DriverError::TopicNotOpen { .. }) => taken.unheard += 1,
            }
        }
        drop(signs);
        link.close();
        Ok(taken)
    }
}

impl fmt::Display for Taken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { readings, fields, refused, unheard } = self;
        write!(f, "{readings} readings given, {fields} of them with a field")?;
        if *refused > 0 {
            write!(f, "; {refused} messages refused")?;
        }
        if *unheard > 0 {
            write!(f, "; {unheard} readings came while no system took any")?;
        }
        Ok(())
    }
}
