//! Methods of the accelerometer stages `inclinometer-matrix` and `inclinometer-quaternion`, which
//! derive the up direction from pitch and roll.
//!
//! Like the paper, they assume linear characteristics, equal slopes and orthogonal axes, which a
//! [`Calibration`](crate::calibration::Calibration) provides.
//!
//! The method comes from the geonavigation paper cited below. The axes of the paper are X forward,
//! Y right, Z down, and its sensor measures gravity, so Z reads +g at rest. In the axes of this
//! crate (ξ right, η forward, ζ up) and with the specific force f, which is opposite to gravity,
//!
//! g_x = −f_η, g_y = −f_ξ, g_z = f_ζ.
//!
//! Pitch β is positive nose up and roll ψ positive right side down. They are ϑ and γ of Matveev
//! 2025, (22).
//!
//! β = atan2(−g_x, √(g_y² + g_z²)), ψ = atan2(g_y, g_z) — Mathematical modelling of geonavigation
//! measuring systems with three-component accelerometers (matrix and quaternion methods).

use crate::{Quaternion, Vector3, point::Point, state::Attitude};

/// Returns the point of the up direction, computed from pitch and roll by the matrix method.
///
/// Returns `None` if the direction is undefined.
pub(super) fn point_by_matrix(force_m_s2: Vector3<f64>) -> Option<Point> {
    let [pitch_rad, roll_rad] = pitch_and_roll_rad(force_m_s2);
    let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(pitch_rad), libm::sincos(roll_rad));
    Point::from_direction(Vector3::new(-sin_roll * cos_pitch, sin_pitch, cos_roll * cos_pitch))
}

/// Returns the point of the up direction, computed by the quaternion method.
pub(super) fn point_by_quaternion(force_m_s2: Vector3<f64>) -> Point {
    let [pitch_rad, roll_rad] = pitch_and_roll_rad(force_m_s2);
    Attitude::from_quaternion(tilt_quaternion(pitch_rad, roll_rad)).up
}

fn pitch_and_roll_rad(force_m_s2: Vector3<f64>) -> [f64; 2] {
    let (gx, gy, gz) = (-force_m_s2.y, -force_m_s2.x, force_m_s2.z);
    [libm::atan2(-gx, libm::hypot(gy, gz)), libm::atan2(gy, gz)]
}

/// Returns the quaternion of pitch and roll.
///
/// With pitch β and roll ψ, λ = (cos β/2 cos ψ/2, cos β/2 sin ψ/2, sin β/2 cos ψ/2, −sin β/2 sin
/// ψ/2) about X, Y, Z, which here are η, ξ and −ζ.
fn tilt_quaternion(pitch_rad: f64, roll_rad: f64) -> Quaternion<f64> {
    let ((sin_pitch, cos_pitch), (sin_roll, cos_roll)) = (libm::sincos(0.5 * pitch_rad), libm::sincos(0.5 * roll_rad));
    Quaternion::new(cos_pitch * cos_roll, sin_pitch * cos_roll, cos_pitch * sin_roll, sin_pitch * sin_roll)
}
