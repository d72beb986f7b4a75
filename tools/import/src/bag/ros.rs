//! Decoding of ROS 2 messages.
//!
//! Input: CDR of `sensor_msgs` and `geometry_msgs`. Axes: body forward, left, up; earth east,
//! north, up (REP 103, REP 145).
//!
//! Output: samples in native axes and units.
//!
//! Time: `header.stamp`.
//!
//! Failure: `None` if the message is malformed, not finite or marked as not measured.

use attitude::frames::{self, Body, Earth};
use byteorder::{BigEndian, LittleEndian};
use mapping::is_rotation;
use recording::Reference;
use serde::{Deserialize, de::DeserializeOwned};

use super::{
    samples::{InertialSample, Position, VelocityFix},
    topics::Kind,
};
use crate::{
    Mapping,
    row_writer::{Attitude, Sample},
};

const UT_PER_T: f64 = 1e6;
const NS_PER_S: u32 = 1_000_000_000;
/// First element of the covariance of a quantity that was not measured.
const NOT_MEASURED: f64 = -1.0;
/// `NavSatStatus` value that means no fix.
const NO_FIX: i8 = -1;

#[derive(Deserialize)]
struct Stamp {
    sec: i32,
    nanosec: u32,
}

#[derive(Deserialize)]
struct Header {
    stamp: Stamp,
    #[expect(dead_code, reason = "part of the message layout")]
    frame_id: String,
}

#[derive(Deserialize)]
struct Imu {
    header: Header,
    /// Quaternion x, y, z, w.
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

/// `TwistStamped`, and the leading fields of `TwistWithCovarianceStamped`.
#[derive(Deserialize)]
struct TwistStamped {
    header: Header,
    linear: [f64; 3],
}

#[derive(Deserialize)]
struct NavSatFix {
    #[expect(dead_code, reason = "part of the message layout")]
    header: Header,
    status: i8,
    #[expect(dead_code, reason = "part of the message layout")]
    service: u16,
    latitude: f64,
    longitude: f64,
    altitude: f64,
}

/// `PoseStamped`, and the leading fields of `PoseWithCovarianceStamped`.
#[derive(Deserialize)]
struct PoseStamped {
    header: Header,
    #[expect(dead_code, reason = "part of the message layout")]
    position: [f64; 3],
    orientation: [f64; 4],
}

/// `TransformStamped`, and the leading fields of `Odometry`.
#[derive(Deserialize)]
struct ChildPoseStamped {
    header: Header,
    #[expect(dead_code, reason = "part of the message layout")]
    child_frame_id: String,
    #[expect(dead_code, reason = "part of the message layout")]
    position: [f64; 3],
    orientation: [f64; 4],
}

/// Units and axes of ROS messages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Convention {
    /// Factors that convert body rate, specific force and magnetic field to rad/s, m/s² and µT.
    rate: f64,
    force: f64,
    field: f64,
    body: Body,
    earth: Earth,
}

impl Default for Convention {
    fn default() -> Self {
        Self { rate: 1.0, force: 1.0, field: UT_PER_T, body: Body::Flu, earth: Earth::Enu }
    }
}

impl Convention {
    /// Returns the units and axes that the user specified. The default for the others is REP 103.
    pub(crate) fn new(mapping: &Mapping) -> Self {
        let (standard, units, (body, earth)) = (Self::default(), mapping.units(), mapping.frame());
        Self {
            rate: units.rate.unwrap_or(standard.rate),
            force: units.force.unwrap_or(standard.force),
            field: units.field.unwrap_or(standard.field),
            body: body.unwrap_or(standard.body),
            earth: earth.unwrap_or(standard.earth),
        }
    }

    /// Returns the factor that converts the magnetic field to µT.
    pub(crate) fn field_factor(&self) -> f64 {
        self.field
    }

    fn to_native(self, vector: [f64; 3], factor: f64) -> Option<[f64; 3]> {
        Some(self.body.to_native(finite(vector)?.map(|part| part * factor)))
    }
}

/// Decodes a `sensor_msgs/msg/Imu`, with its attitude if present. Returns `None` if the message has
/// neither a body rate nor a specific force.
pub(crate) fn inertial(data: &[u8], convention: &Convention) -> Option<InertialSample> {
    let imu: Imu = decode(data)?;
    let t_ns = imu.header.stamp.ns()?;
    let is_measured = |covariance: &[f64; 9]| covariance[0] != NOT_MEASURED;
    let [x, y, z, w] = imu.orientation;
    let has_attitude = is_measured(&imu.orientation_covariance) && is_rotation([w, x, y, z]);
    let quaternion = frames::quaternion_to_native(convention.earth, convention.body, [w, x, y, z]);
    let reference = Reference { quaternion, scored: true };
    let measured = |vector, covariance, factor| match is_measured(covariance) {
        true => convention.to_native(vector, factor).map(Some),
        false => Some(None),
    };
    let rate_rad_s = measured(imu.angular_velocity, &imu.angular_velocity_covariance, convention.rate)?;
    let force_m_s2 = measured(imu.linear_acceleration, &imu.linear_acceleration_covariance, convention.force)?;
    if rate_rad_s.is_none() && force_m_s2.is_none() {
        return None;
    }
    Some(InertialSample {
        t_ns,
        rate_rad_s,
        force_m_s2,
        is_instant: false,
        attitude: has_attitude.then_some(Attitude { t_ns, reference, reset_counter: Some(0) }),
    })
}

/// Decodes a `sensor_msgs/msg/MagneticField`. The magnetic field is in native axes, µT.
pub(crate) fn field(data: &[u8], convention: &Convention) -> Option<Sample> {
    let MagneticField { header, magnetic_field } = decode(data)?;
    Some((header.stamp.ns()?, convention.to_native(magnetic_field, convention.field)?))
}

/// Decodes the attitude of a pose: the rotation from body axes to east, north, up.
pub(super) fn attitude(kind: Kind, data: &[u8], convention: &Convention) -> Option<Attitude> {
    let (header, [x, y, z, w]) = if kind == Kind::ChildPose {
        let ChildPoseStamped { header, orientation, .. } = decode(data)?;
        (header, orientation)
    } else {
        let PoseStamped { header, orientation, .. } = decode(data)?;
        (header, orientation)
    };
    let native = || frames::quaternion_to_native(convention.earth, convention.body, [w, x, y, z]);
    let quaternion = is_rotation([w, x, y, z]).then(native)?;
    let reference = Reference { quaternion, scored: true };
    Some(Attitude { t_ns: header.stamp.ns()?, reference, reset_counter: Some(0) })
}

/// Decodes a `geometry_msgs/msg/TwistStamped`.
///
/// The velocity is interpreted as east, north, up, the axes in which GNSS receivers publish it.
pub(super) fn velocity(data: &[u8]) -> Option<VelocityFix> {
    let TwistStamped { header, linear } = decode(data)?;
    Some(VelocityFix { t_ns: header.stamp.ns()?, velocity_m_s: finite(linear)?, position: None })
}

/// Decodes a `sensor_msgs/msg/NavSatFix`.
pub(super) fn position(data: &[u8]) -> Option<Position> {
    let NavSatFix { status, latitude, longitude, altitude, .. } = decode(data)?;
    let [latitude_deg, longitude_deg] = [latitude, longitude];
    let is_fix = status > NO_FIX && latitude.is_finite() && longitude.is_finite();
    is_fix.then_some(Position { latitude_deg, longitude_deg, altitude_m: altitude })
}

impl Stamp {
    fn ns(&self) -> Option<i64> {
        (self.nanosec < NS_PER_S).then(|| i64::from(self.sec) * i64::from(NS_PER_S) + i64::from(self.nanosec))
    }
}

/// Decodes CDR. The first two bytes specify the byte order; the next two are ignored.
fn decode<T: DeserializeOwned>(data: &[u8]) -> Option<T> {
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
