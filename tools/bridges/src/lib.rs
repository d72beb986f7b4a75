//! The attitude for others, in their protocols.
//!
//! Input: messages of a running system. Output: messages of others, in their frames. Time: given with each message. Failure: what nobody should
//! rely on is not sent; a receiver that is absent, slow or frozen costs the datagrams that it does not take. Nothing is ever received.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`mavlink`] | HEARTBEAT, ATTITUDE_QUATERNION and ATTITUDE |
//! | [`ros`] | `sensor_msgs/Imu` of ROS 2, as rmw_zenoh has it |
//! | [`soundness`] | what is worth being sent |
//! | [`datagrams`] | to one address by UDP, without waiting |
#![forbid(unsafe_code)]

pub mod datagrams;
pub mod mavlink;
pub mod ros;
pub mod soundness;
