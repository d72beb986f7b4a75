//! ROS 2 messages as CDR (XCDR1, little-endian).
//!
//! - Input: messages of the system in the native frame, and statuses.
//! - Output: encoded messages of `sensor_msgs`, `tf2_msgs` and `diagnostic_msgs`.
//! - Frames: REP 103 and REP 145. The orientation is that of the body axes forward, left, up in the
//!   earth axes east, north, up. Body rate, specific force and magnetic field are in forward, left,
//!   up; at rest the specific force is +g upwards.
//! - Time: `stamp_ns` is in nanoseconds since 1970.

use attitude::frames::{Body, Frame};
use byteorder::LittleEndian;
use messages::{AttitudeOutput, ImuSample, MagSample};
use runtime::frames::attitude_to_frame;
use serde::Serialize;

use crate::diagnostics::Status;

/// Header of plain CDR, little-endian.
const ENCAPSULATION_HEADER: [u8; 4] = [0, 1, 0, 0];
const NS_PER_S: i64 = 1_000_000_000;
/// Covariance that means "unknown" in the message definitions.
const UNKNOWN_COVARIANCE: [f64; 9] = [0.0; 9];
/// Tesla per microtesla.
const TESLA_PER_UT: f64 = 1e-6;

/// Encodes `sensor_msgs/msg/Imu`.
///
/// Orientation and bias-corrected rate are estimates; the specific force is the calibrated
/// measurement. Only the orientation has a known covariance.
///
/// # Errors
///
/// Returns an error if CDR cannot represent the message.
pub fn encode_imu(
    attitude: &AttitudeOutput,
    sample: &ImuSample,
    stamp_ns: i64,
    frame_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    let in_ros_frame = attitude_to_frame(Frame::EnuFlu, *attitude);
    let [inclination_variance, course_variance] =
        [attitude.inclination_sd_rad, attitude.course_sd_rad].map(|sd| sd * sd);
    encode(&Imu {
        header: Header::new(stamp_ns, frame_id),
        orientation: xyzw(in_ros_frame.quaternion),
        orientation_covariance: [
            inclination_variance,
            0.0,
            0.0,
            0.0,
            inclination_variance,
            0.0,
            0.0,
            0.0,
            course_variance,
        ],
        angular_velocity: in_ros_frame.rate_rad_s,
        angular_velocity_covariance: UNKNOWN_COVARIANCE,
        linear_acceleration: Body::Flu.vector(sample.force_m_s2),
        linear_acceleration_covariance: UNKNOWN_COVARIANCE,
    })
}

/// Encodes `tf2_msgs/msg/TFMessage` with the rotation from `child_frame_id` to `parent_frame_id`.
///
/// The translation is zero, because the position is unknown: the origin of the parent frame moves
/// with the body.
///
/// # Errors
///
/// Returns an error if CDR cannot represent the message.
pub fn encode_transform(
    attitude: &AttitudeOutput,
    stamp_ns: i64,
    parent_frame_id: &str,
    child_frame_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    let transform = TransformStamped {
        header: Header::new(stamp_ns, parent_frame_id),
        child_frame_id,
        translation: [0.0; 3],
        rotation: xyzw(Frame::EnuFlu.quaternion(attitude.quaternion)),
    };
    encode(&TfMessage { transforms: &[transform] })
}

/// Encodes `sensor_msgs/msg/MagneticField`, in tesla. The covariance is unknown.
///
/// # Errors
///
/// Returns an error if CDR cannot represent the message.
pub fn encode_magnetic_field(
    sample: &MagSample,
    stamp_ns: i64,
    frame_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    encode(&MagneticField {
        header: Header::new(stamp_ns, frame_id),
        magnetic_field: Body::Flu.vector(sample.field_ut).map(|part_ut| part_ut * TESLA_PER_UT),
        magnetic_field_covariance: UNKNOWN_COVARIANCE,
    })
}

/// Encodes `diagnostic_msgs/msg/DiagnosticArray`. `hardware_id` applies to every status.
///
/// # Errors
///
/// Returns an error if CDR cannot represent the message.
pub fn encode_diagnostics(
    statuses: &[Status],
    stamp_ns: i64,
    hardware_id: &str,
) -> Result<Vec<u8>, cdr_encoding::Error> {
    let status = statuses.iter().map(|Status { level, name, message, values }| DiagnosticStatus {
        level: *level as u8,
        name,
        message,
        hardware_id,
        values: values.iter().map(|(key, value)| KeyValue { key, value }).collect(),
    });
    encode(&DiagnosticArray { header: Header::new(stamp_ns, ""), status: status.collect() })
}

fn encode(message: &impl Serialize) -> Result<Vec<u8>, cdr_encoding::Error> {
    let mut bytes = ENCAPSULATION_HEADER.to_vec();
    bytes.extend(cdr_encoding::to_vec::<_, LittleEndian>(message)?);
    Ok(bytes)
}

fn xyzw([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [x, y, z, w]
}

#[derive(Serialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Serialize)]
struct Header<'a> {
    stamp: Time,
    frame_id: &'a str,
}

impl<'a> Header<'a> {
    fn new(stamp_ns: i64, frame_id: &'a str) -> Self {
        let stamp = Time { sec: stamp_ns.div_euclid(NS_PER_S) as i32, nanosec: stamp_ns.rem_euclid(NS_PER_S) as u32 };
        Self { stamp, frame_id }
    }
}

/// Message `sensor_msgs/msg/Imu`, with the fields in the order of the message definition. The
/// quaternion is x, y, z, w.
#[derive(Serialize)]
struct Imu<'a> {
    header: Header<'a>,
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    angular_velocity: [f64; 3],
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: [f64; 3],
    linear_acceleration_covariance: [f64; 9],
}

#[derive(Serialize)]
struct TfMessage<'a> {
    transforms: &'a [TransformStamped<'a>],
}

/// Message `geometry_msgs/msg/TransformStamped`, with the fields in the order of the message
/// definition. The quaternion is x, y, z, w.
#[derive(Serialize)]
struct TransformStamped<'a> {
    header: Header<'a>,
    child_frame_id: &'a str,
    translation: [f64; 3],
    rotation: [f64; 4],
}

#[derive(Serialize)]
struct MagneticField<'a> {
    header: Header<'a>,
    magnetic_field: [f64; 3],
    magnetic_field_covariance: [f64; 9],
}

#[derive(Serialize)]
struct DiagnosticArray<'a> {
    header: Header<'a>,
    status: Vec<DiagnosticStatus<'a>>,
}

#[derive(Serialize)]
struct DiagnosticStatus<'a> {
    level: u8,
    name: &'a str,
    message: &'a str,
    hardware_id: &'a str,
    values: Vec<KeyValue<'a>>,
}

#[derive(Serialize)]
struct KeyValue<'a> {
    key: &'a str,
    value: &'a str,
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;
    use crate::diagnostics::Level;

    /// Encapsulation header and a timestamp of 1.5 s.
    const START: [u8; 12] = [0, 1, 0, 0, 1, 0, 0, 0, 0, 0x65, 0xcd, 0x1d];
    const STAMP_NS: i64 = 1_500_000_000;

    fn numbers(bytes: &[u8]) -> Vec<f64> {
        bytes.chunks_exact(8).map(|eight| f64::from_le_bytes(eight.try_into().unwrap())).collect()
    }

    /// Level attitude facing north.
    fn level() -> AttitudeOutput {
        AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], course_sd_rad: 0.5, ..Zeroable::zeroed() }
    }

    fn is_close(found: &[f64], expected: &[f64]) -> bool {
        found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15)
    }

    #[test]
    fn imu_message_has_cdr_layout() {
        let sample = ImuSample { force_m_s2: [0.1, 0.2, 9.8], ..Zeroable::zeroed() };
        let bytes = encode_imu(&level(), &sample, STAMP_NS, "imu_link").unwrap();
        // The timestamp is followed by the length of the frame name (nine bytes including the
        // terminating zero). After the name, each number is aligned to 8 bytes, counted from the
        // end of the encapsulation header.
        assert_eq!(&bytes[..16], [&START[..], &[9, 0, 0, 0]].concat());
        assert_eq!((&bytes[16..25], bytes.len()), (&b"imu_link\0"[..], 324));
        let numbers = numbers(&bytes[28..]);
        // ROS measures yaw from east, so an attitude that faces north is a rotation by 90°.
        let h = 0.5f64.sqrt();
        assert!(is_close(&numbers[..4], &[0.0, 0.0, h, h]), "{numbers:?}");
        assert_eq!((numbers[12], &numbers[25..28]), (0.25, &[0.2, -0.1, 9.8][..]));
    }

    #[test]
    fn transform_message_has_cdr_layout() {
        let bytes = encode_transform(&level(), STAMP_NS, "map", "imu_link").unwrap();
        // A sequence begins with the number of its elements.
        assert_eq!(&bytes[..8], &[0, 1, 0, 0, 1, 0, 0, 0]);
        assert_eq!(&bytes[8..16], &START[4..]);
        assert_eq!(&bytes[16..24], [&[4, 0, 0, 0][..], b"map\0"].concat());
        assert_eq!(&bytes[24..37], [&[9, 0, 0, 0][..], b"imu_link\0"].concat());
        let h = 0.5f64.sqrt();
        let numbers = numbers(&bytes[44..]);
        assert!(is_close(&numbers, &[0.0, 0.0, 0.0, 0.0, 0.0, h, h]), "{numbers:?}");
    }

    #[test]
    fn magnetic_field_is_in_tesla_and_body_axes_of_ros() {
        let sample = MagSample { field_ut: [20.0, 30.0, -40.0], ..Zeroable::zeroed() };
        let bytes = encode_magnetic_field(&sample, STAMP_NS, "imu_link").unwrap();
        assert_eq!((&bytes[..12], bytes.len()), (&START[..], 28 + 12 * 8));
        let numbers = numbers(&bytes[28..]);
        assert!(is_close(&numbers, &[&[30e-6, -20e-6, -40e-6][..], &[0.0; 9]].concat()), "{numbers:?}");
    }

    #[test]
    fn diagnostics_have_cdr_layout() {
        let values = vec![("rate_hz", "100".into())];
        let status = Status { level: Level::Stale, name: "a".into(), message: "b".into(), values };
        let bytes = encode_diagnostics(&[status], STAMP_NS, "sys").unwrap();
        let expected = [
            &START[..],
            // Empty frame name, aligned.
            &[1, 0, 0, 0, 0, 0, 0, 0],
            // One status with its level, then three aligned texts.
            &[1, 0, 0, 0, 3, 0, 0, 0],
            &[2, 0, 0, 0, b'a', 0, 0, 0],
            &[2, 0, 0, 0, b'b', 0, 0, 0],
            &[4, 0, 0, 0, b's', b'y', b's', 0],
            // One pair of key and value.
            &[1, 0, 0, 0, 8, 0, 0, 0],
            b"rate_hz\0",
            &[4, 0, 0, 0, b'1', b'0', b'0', 0],
        ];
        assert_eq!(bytes, expected.concat());
    }
}
