//! What is a rotation.

/// By how much the length of an attitude's quaternion may differ from 1.
const LENGTH_TOLERANCE: f64 = 0.01;

/// A quaternion of unit length, as far as others round it.
pub fn is_rotation(quaternion: [f64; 4]) -> bool {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    (length - 1.0).abs() <= LENGTH_TOLERANCE
}
