//! Magnetic field as a direction, and the heading derived from it.

use crate::{
    Complex, Vector3,
    state::{Attitude, arg},
};

/// Smallest magnetic field that has a usable direction, µT: about a thousandth of the earth's
/// field.
const MIN_FIELD_UT: f64 = 0.05;

/// Returns the correction of z that turns the horizontal magnetic field to the reference axis η0.
///
/// The correction is in rad, (−π, π]. For the levelled field m' = A(w)ᵀ m, it is z_mag − z with
/// z_mag = atan2(m'_ξ, m'_η). The code rotates m' by z first, which gives the same angle.
pub(super) fn heading_correction_rad(attitude: Attitude, field: Vector3<f64>) -> f64 {
    let h = attitude.horizontal(field);
    let (sin, cos) = libm::sincos(attitude.z_rad);
    // The magnetic field is rotated by z into the reference frame, in which η0 is north.
    arg(Complex::new(h.re * sin + h.im * cos, h.re * cos - h.im * sin))
}

/// Returns the direction of a magnetic field, or `None` if it is too weak or not finite.
pub(super) fn field_direction(field_ut: Vector3<f64>) -> Option<Vector3<f64>> {
    let norm_ut = field_ut.norm();
    (norm_ut > MIN_FIELD_UT && norm_ut.is_finite()).then(|| field_ut / norm_ut)
}
