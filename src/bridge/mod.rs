//! `plumb bridge`: forwards attitudes to other protocols, and readings from ROS 2 to a system.

mod mavlink;
#[cfg(feature = "network")]
mod ros;
#[cfg(feature = "network")]
mod ros_sensor;
mod sender;

use std::{fmt, process::ExitCode};

use clap::Subcommand;
use serde::Serialize;

#[cfg(not(feature = "network"))]
use crate::absent::{ros, ros_sensor};
use crate::{failure::fail, stdout::print};
use sender::BridgeError;

#[derive(Subcommand)]
pub(crate) enum Bridge {
    /// Send the attitude as MAVLink 2 over UDP
    Mavlink(mavlink::Mavlink),
    /// Publish the attitude as sensor_msgs/msg/Imu over rmw_zenoh
    Ros(ros::Ros),
    /// Feed ROS 2 IMU topics (rmw_zenoh) to a system with source = "bus"
    RosSensor(ros_sensor::RosSensor),
}

pub(crate) fn run(bridge: &Bridge) -> ExitCode {
    match bridge {
        Bridge::Mavlink(mavlink) => print_counts(mavlink.run(), mavlink.args.system.json),
        Bridge::Ros(ros) => ros::run(ros),
        Bridge::RosSensor(sensor) => ros_sensor::run(sensor),
    }
}

/// Prints the counts or the error.
fn print_counts<C: Serialize + fmt::Display>(counts: Result<C, BridgeError>, json: bool) -> ExitCode {
    match counts {
        // Serialising numbers cannot fail.
        Ok(counts) if json => print(&serde_json::to_string(&counts).unwrap_or_default()),
        Ok(counts) => print(&counts),
        Err(error) => fail(&error, error.exit_code()),
    }
}
