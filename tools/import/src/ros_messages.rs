//! Messages of ROS 2 one by one, as they come over a network.
//!
//! Input: CDR with its encapsulation. Output: what it says, in our axes (right, forward, up) and units. Time: `header.stamp`, ns since 1970. Failure: `None` of
//! what is malformed, not finite or said to be absent.

use crate::bag::ros;

/// Rate and force at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    /// `header.stamp`, ns.
    pub t_ns: i64,
    /// Body rate, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Specific force, m/s².
    pub force_m_s2: [f64; 3],
}

/// `sensor_msgs/msg/Imu`; its orientation is left out.
pub fn imu(data: &[u8]) -> Option<Imu> {
    let inertial = ros::inertial(data)?;
    Some(Imu { t_ns: inertial.t_ns, rate_rad_s: inertial.rate_rad_s, force_m_s2: inertial.force_m_s2 })
}

/// `sensor_msgs/msg/MagneticField`: the field, µT.
pub fn field_ut(data: &[u8]) -> Option<[f64; 3]> {
    ros::field(data).map(|(_, field_ut)| field_ut)
}
