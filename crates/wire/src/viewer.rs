//! Attitude and position in the published schemas `foxglove.*`, which viewers display without
//! setup.
//!
//! Input: time since 1970 and a rotation or position. The caller names the frames.
//!
//! Output: encoded messages.

use prost::Message as _;
use prost_types::Timestamp;

/// Generated types of `proto/foxglove`.
#[allow(missing_docs, unreachable_pub, clippy::all, reason = "generated")]
mod foxglove {
    include!("generated/foxglove.rs");
}

use foxglove::{FrameTransform, LocationFix, Pose, PoseInFrame, Quaternion, Vector3};

/// Name of the schema of [`frame_transform`].
pub const FRAME_TRANSFORM: &str = "foxglove.FrameTransform";
/// Name of the schema of [`pose_in_frame`].
pub const POSE_IN_FRAME: &str = "foxglove.PoseInFrame";
/// Name of the schema of [`location_fix`].
pub const LOCATION_FIX: &str = "foxglove.LocationFix";

/// Encodes the rotation from the frame `child` to the frame `parent`, which share an origin.
pub fn frame_transform(t_ns: u64, parent: &str, child: &str, xyzw: [f64; 4]) -> Vec<u8> {
    FrameTransform {
        timestamp: Some(timestamp(t_ns)),
        parent_frame_id: parent.into(),
        child_frame_id: child.into(),
        translation: Some(Vector3::default()),
        rotation: Some(quaternion(xyzw)),
    }
    .encode_to_vec()
}

/// Encodes a rotation as a pose at the origin of `frame`.
pub fn pose_in_frame(t_ns: u64, frame: &str, xyzw: [f64; 4]) -> Vec<u8> {
    let pose = Pose { position: Some(Vector3::default()), orientation: Some(quaternion(xyzw)) };
    PoseInFrame { timestamp: Some(timestamp(t_ns)), frame_id: frame.into(), pose: Some(pose) }.encode_to_vec()
}

/// Encodes the position of `frame`: latitude and longitude in degrees, altitude in metres.
pub fn location_fix(t_ns: u64, frame: &str, [latitude, longitude, altitude]: [f64; 3]) -> Vec<u8> {
    let (timestamp, frame_id) = (Some(timestamp(t_ns)), frame.into());
    LocationFix { timestamp, frame_id, latitude, longitude, altitude, ..LocationFix::default() }.encode_to_vec()
}

fn timestamp(t_ns: u64) -> Timestamp {
    // The cast cannot overflow, because a 64-bit number of nanoseconds has at most 35 bits of
    // seconds.
    Timestamp { seconds: (t_ns / 1_000_000_000).cast_signed(), nanos: (t_ns % 1_000_000_000) as i32 }
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}
