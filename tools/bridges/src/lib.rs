//! Bridges that send the attitude in other protocols.
//!
//! - Input: messages of a running system.
//! - Output: MAVLink and ROS 2 messages, in the frames of these protocols.
//! - Time: given with each message.
//! - Failure: an invalid or stale attitude is not sent. An absent, slow or frozen receiver only
//!   loses datagrams.
//!
//! This crate receives nothing from the network.
//!
//! | module | contents |
//! | --- | --- |
//! | [`mavlink`] | HEARTBEAT, ATTITUDE_QUATERNION, ATTITUDE, ODOMETRY and GLOBAL_POSITION_INT |
//! | [`ros`] | keys, liveliness tokens and attachments of ROS 2, as in rmw_zenoh |
//! | [`ros_messages`] | messages of ROS 2 |
//! | [`diagnostics`] | statuses of a system for `/diagnostics` |
//! | [`validity`] | check before an attitude is sent |
//! | [`datagrams`] | non-blocking UDP sender |
#![forbid(unsafe_code)]

pub mod datagrams;
pub mod diagnostics;
pub mod mavlink;
pub mod ros;
pub mod ros_messages;
pub mod validity;
