//! `plumb bridge`: forwards attitudes to other protocols, and readings from ROS 2 to a system.

mod mavlink;
#[cfg(feature = "network")]
mod ros;
#[cfg(feature = "network")]
mod ros_sensor;
mod sender;
#[cfg(feature = "network")]
mod status_poller;

use clap::Subcommand;

#[cfg(not(feature = "network"))]
use crate::absent::{ros, ros_sensor};
use crate::failure::Outcome;

#[derive(Subcommand)]
pub(crate) enum Bridge {
    /// Send the attitude as MAVLink 2 over UDP
    Mavlink(mavlink::Mavlink),
    /// Publish Imu, MagneticField, /tf and /diagnostics over rmw_zenoh
    Ros(ros::Ros),
    /// Feed ROS 2 IMU topics (rmw_zenoh) to a system with source = "bus"
    RosSensor(ros_sensor::RosSensor),
}

pub(crate) fn run(bridge: &Bridge) -> Outcome {
    match bridge {
        Bridge::Mavlink(mavlink) => mavlink.run(),
        Bridge::Ros(ros) => ros::run(ros),
        Bridge::RosSensor(sensor) => ros_sensor::run(sensor),
    }
}
