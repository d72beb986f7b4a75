//! Decodes individual ROS 2 messages received over a network.
//!
//! Input: CDR with its encapsulation header.
//!
//! Output: the content in native axes (right, forward, up) and units.
//!
//! Time: `header.stamp`, ns since 1970.
//!
//! Failure: `None` if the message is malformed, contains a value that is not finite, or is marked
//! as not measured.

use crate::bag::ros::{self, Convention};

/// Sample of body rate and specific force in native axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    /// Time from `header.stamp`, ns.
    pub t_ns: i64,
    /// Body rate, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s².
    pub force_m_s2: [f64; 3],
}

/// Decodes a `sensor_msgs/msg/Imu`. The orientation is ignored.
pub fn imu(data: &[u8]) -> Option<Imu> {
    let inertial = ros::inertial(data, &Convention::default())?;
    Some(Imu { t_ns: inertial.t_ns, rate_rad_s: inertial.rate_rad_s?, force_m_s2: inertial.force_m_s2? })
}

/// Decodes a `sensor_msgs/msg/MagneticField` and returns the magnetic field in native axes, µT.
pub fn field_ut(data: &[u8]) -> Option<[f64; 3]> {
    ros::field(data, &Convention::default()).map(|(_, field_ut)| field_ut)
}
