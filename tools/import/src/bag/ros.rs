//! Messages of ROS 2.
//!
//! Input: CDR as `sensor_msgs` and `geometry_msgs` define it. Output: samples in our axes and units. Frames: body forward, left, up and
//! earth east, north, up (REP 103, REP 145). Time: `header.stamp`. Failure: `None` of what is malformed, not finite or said to be absent.

use attitude::frames::{self, Body, Earth};
use byteorder::{BigEndian, LittleEndian};
use mapping::is_rotation;
use recording::Reference;
use serde::{Deserialize, de::DeserializeOwned};

use super::{Fix, Inertial, Position};
use crate::{force_aligner::Sample, row_writer::Attitude};

const UT_PER_T: f64 = 1e6;
const NS_PER_S: u32 = 1_000_000_000;
/// What the first number of a covariance says of a quantity that is not measured.
const ABSENT: f64 = -1.0;
/// `NavSatStatus`: no fix.
const NO_FIX: i8 = -1;

#[derive(Deserialize)]
struct Stamp {
    sec: i32,
    nanosec: u32,
}

#[derive(Deserialize)]
struct Header {
    stamp: Stamp,
    #[expect(dead_code, reason = "it has a place in the message")]
    frame_id: String,
}

#[derive(Deserialize)]
struct Imu {
    header: Header,
    /// x, y, z, w.
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    angular_velocity: [f64; 3],
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: [f64; 3],
    linear_acceleration_covariance: [f64; 9],
}

#[derive(Deserialize)]
struct MagneticField {
    header: Header,
    magnetic_field: [f64; 3],
}

/// `TwistStamped` and, as far as it goes, `TwistWithCovarianceStamped`.
#[derive(Deserialize)]
struct TwistStamped {
    header: Header,
    linear: [f64; 3],
}

#[derive(Deserialize)]
struct NavSatFix {
    #[expect(dead_code, reason = "it has a place in the message")]
    header: Header,
    status: i8,
    #[expect(dead_code, reason = "it has a place in the message")]
    service: u16,
    latitude: f64,
    longitude: f64,
    altitude: f64,
}

/// `sensor_msgs/msg/Imu`; the attitude where there is one.
pub(crate) fn inertial(data: &[u8]) -> Option<Inertial> {
    let imu: Imu = decoded(data)?;
    let t_ns = imu.header.stamp.ns()?;
    let is_there = |covariance: &[f64; 9]| covariance[0] != ABSENT;
    if !is_there(&imu.angular_velocity_covariance) || !is_there(&imu.linear_acceleration_covariance) {
        return None;
    }
    let [x, y, z, w] = imu.orientation;
    let has_attitude = is_there(&imu.orientation_covariance) && is_rotation([w, x, y, z]);
    let reference = Reference { quaternion: frames::quaternion_to_native(Earth::Enu, Body::Flu, [w, x, y, z]), scored: true };
    Some(Inertial {
        t_ns,
        rate_rad_s: Body::Flu.to_native(finite(imu.angular_velocity)?),
        force_m_s2: Body::Flu.to_native(finite(imu.linear_acceleration)?),
        is_instant: false,
        attitude: has_attitude.then_some(Attitude { t_ns, reference, reset_counter: Some(0) }),
    })
}

/// `sensor_msgs/msg/MagneticField`.
pub(crate) fn field(data: &[u8]) -> Option<Sample> {
    let MagneticField { header, magnetic_field } = decoded(data)?;
    Some((header.stamp.ns()?, Body::Flu.to_native(finite(magnetic_field)?.map(|part| part * UT_PER_T))))
}

/// `geometry_msgs/msg/TwistStamped`: east, north, up, as receivers publish it.
pub(super) fn velocity(data: &[u8]) -> Option<Fix> {
    let TwistStamped { header, linear } = decoded(data)?;
    Some(Fix { t_ns: header.stamp.ns()?, velocity_m_s: finite(linear)?, position: None })
}

/// `sensor_msgs/msg/NavSatFix`.
pub(super) fn position(data: &[u8]) -> Option<Position> {
    let NavSatFix { status, latitude, longitude, altitude, .. } = decoded(data)?;
    let [latitude_deg, longitude_deg] = [latitude, longitude];
    let is_fix = status > NO_FIX && latitude.is_finite() && longitude.is_finite();
    is_fix.then_some(Position { latitude_deg, longitude_deg, altitude_m: altitude })
}

impl Stamp {
    fn ns(&self) -> Option<i64> {
        (self.nanosec < NS_PER_S).then(|| i64::from(self.sec) * i64::from(NS_PER_S) + i64::from(self.nanosec))
    }
}

/// The first two bytes say the order of the others; the next two say nothing.
fn decoded<T: DeserializeOwned>(data: &[u8]) -> Option<T> {
    let message = match data.get(..4)? {
        [0, 0, ..] => cdr_encoding::from_bytes::<T, BigEndian>(&data[4..]),
        [0, 1, ..] => cdr_encoding::from_bytes::<T, LittleEndian>(&data[4..]),
        _ => return None,
    };
    message.ok().map(|(message, _)| message)
}

fn finite(vector: [f64; 3]) -> Option<[f64; 3]> {
    vector.iter().all(|part| part.is_finite()).then_some(vector)
}
