//! The geometry of levelling: axes of the level frame and of the platform, tilts and accelerations in them.

use super::limits::{FORCE_LIMIT_M_S2, RATE_LIMIT_RAD_S, bounded};
use crate::{Complex, GRAVITY_M_S2, J, Vector3, state::Attitude};

/// The turn rate H' about the vertical, rad/s, clockwise from above.
pub(super) fn turn_rate_rad_s(attitude: Attitude, rate_rad_s: Vector3<f64>) -> f64 {
    -bounded(rate_rad_s, RATE_LIMIT_RAD_S).dot(&attitude.up.direction())
}

/// The level frame in the axes of the platform, that is of the reference frame: e^{jz}.
pub(super) fn azimuth(attitude: Attitude) -> Complex<f64> {
    let (sin, cos) = libm::sincos(attitude.z_rad);
    Complex::new(cos, sin)
}

/// Forward in the level frame, of unit length; zero where the body points straight up or down.
pub(super) fn forward(attitude: Attitude) -> Complex<f64> {
    let [_, axis, _] = attitude.axes(Complex::new(1.0, 0.0)).horizontal;
    let size = libm::sqrt(axis.norm_sqr());
    if size > 1e-3 { axis / size } else { Complex::new(0.0, 0.0) }
}

/// The acceleration (V H', V') of a vehicle that moves where it points, in the level frame, m/s².
pub(super) fn carried(attitude: Attitude, centripetal_m_s2: f64, along_m_s2: f64) -> Complex<f64> {
    let bounded = |x: f64| x.clamp(-FORCE_LIMIT_M_S2, FORCE_LIMIT_M_S2);
    // Right of forward is forward turned by −90°.
    forward(attitude) * Complex::new(bounded(along_m_s2), -bounded(centripetal_m_s2))
}

/// The lean that takes a tilt away: the level-frame point that half of the tilt's tangent is.
pub(super) fn lean_of(tilt_rad: Complex<f64>) -> Complex<f64> {
    tilt_rad * 0.5
}

/// The tilt that an unexplained acceleration is, rad.
pub(super) fn tilt_of(unexplained_m_s2: Complex<f64>) -> Complex<f64> {
    unexplained_m_s2 / GRAVITY_M_S2
}

/// The rotation of the body, in its own axes, whose horizontal part in the level frame is j times the tilt: what a gyro has turned too
/// much when the level leans by `tilt_rad`.
pub(super) fn turned_too_much(attitude: Attitude, tilt_rad: Complex<f64>) -> Vector3<f64> {
    let turned = J * tilt_rad;
    Vector3::from(
        attitude.axes(Complex::new(1.0, 0.0)).horizontal.map(|axis| axis.re * turned.re + axis.im * turned.im),
    )
}
