//! The magnetic field as a direction, and the heading that it tells.

use crate::{
    Complex, Vector3,
    state::{Attitude, arg},
};

/// Below this a field has no direction, µT: a thousandth of the earth's.
const FIELD_MIN_UT: f64 = 0.05;

/// By how much the heading of an attitude must grow for the field to point to η0, rad, (−π, π].
///
/// z_mag − z, z_mag = atan2(m'_ξ, m'_η) of the levelled field m' = A(w)ᵀ m, which is here turned by z too.
pub(super) fn north_rad(attitude: Attitude, field: Vector3<f64>) -> f64 {
    let h = attitude.horizontal(field);
    let (sin, cos) = libm::sincos(attitude.z_rad);
    // Turned by z into the reference frame, whose η0 is north.
    arg(Complex::new(h.re * sin + h.im * cos, h.re * cos - h.im * sin))
}

/// The direction of a field that has one.
pub(super) fn field_direction(field_ut: Vector3<f64>) -> Option<Vector3<f64>> {
    let norm_ut = field_ut.norm();
    (norm_ut > FIELD_MIN_UT && norm_ut.is_finite()).then(|| field_ut / norm_ut)
}
