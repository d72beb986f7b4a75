//! The attitude as viewers know it: messages of the published schemas `foxglove.*`, so that it is seen without any setting.
//!
//! Input: a time since 1970 and a rotation x, y, z, w. Output: bytes. Frames are named by the caller. Failure: none.

use prost::Message as _;
use prost_types::Timestamp;

/// The types of `proto/foxglove`, as generated.
#[allow(missing_docs, unreachable_pub, clippy::all, reason = "generated")]
mod foxglove {
    include!("generated/foxglove.rs");
}

use foxglove::{FrameTransform, LocationFix, Pose, PoseInFrame, Quaternion, Vector3};

/// The name of the schema of [`frame_transform`].
pub const FRAME_TRANSFORM: &str = "foxglove.FrameTransform";
/// The name of the schema of [`pose_in_frame`].
pub const POSE_IN_FRAME: &str = "foxglove.PoseInFrame";
/// The name of the schema of [`location_fix`].
pub const LOCATION_FIX: &str = "foxglove.LocationFix";

/// The frame `child` turned in the frame `parent`, both with one origin: child → parent.
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

/// The same rotation as a pose at the origin of the frame `frame`.
pub fn pose_in_frame(t_ns: u64, frame: &str, xyzw: [f64; 4]) -> Vec<u8> {
    let pose = Pose { position: Some(Vector3::default()), orientation: Some(quaternion(xyzw)) };
    PoseInFrame { timestamp: Some(timestamp(t_ns)), frame_id: frame.into(), pose: Some(pose) }.encode_to_vec()
}

/// Where the frame `frame` is: latitude, longitude in degrees, altitude in m.
pub fn location_fix(t_ns: u64, frame: &str, [latitude, longitude, altitude]: [f64; 3]) -> Vec<u8> {
    let (timestamp, frame_id) = (Some(timestamp(t_ns)), frame.into());
    LocationFix { timestamp, frame_id, latitude, longitude, altitude, ..LocationFix::default() }.encode_to_vec()
}

fn timestamp(t_ns: u64) -> Timestamp {
    // Seconds of 64 bits of nanoseconds have 35 bits.
    Timestamp { seconds: (t_ns / 1_000_000_000).cast_signed(), nanos: (t_ns % 1_000_000_000) as i32 }
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}
