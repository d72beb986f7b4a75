//! Checks whether a quaternion is a rotation.

/// Largest accepted deviation of a quaternion's length from 1. Allows for quaternions printed with
/// few digits.
const LENGTH_TOLERANCE: f64 = 0.01;

/// Returns `true` if the quaternion has unit length, within rounding to two decimal places.
pub fn is_rotation(quaternion: [f64; 4]) -> bool {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    (length - 1.0).abs() <= LENGTH_TOLERANCE
}
