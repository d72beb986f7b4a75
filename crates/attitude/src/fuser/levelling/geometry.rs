//! Geometry of levelling: axes of the level frame and of the platform, and tilts and accelerations
//! in these axes.

use super::limits::{MAX_FORCE_M_S2, MAX_RATE_RAD_S, limited};
use crate::{Complex, GRAVITY_M_S2, J, Vector3, state::Attitude};

/// Returns the clockwise turn rate H' about the vertical, rad/s.
pub(super) fn turn_rate_rad_s(attitude: Attitude, rate_rad_s: Vector3<f64>) -> f64 {
    -limited(rate_rad_s, MAX_RATE_RAD_S).dot(&attitude.up.direction())
}

/// Returns e^{jz}, the rotation from the level frame to the platform, which is the reference frame.
pub(super) fn azimuth(attitude: Attitude) -> Complex<f64> {
    let (sin, cos) = libm::sincos(attitude.z_rad);
    Complex::new(cos, sin)
}

/// Returns the forward unit vector in the level frame; zero if the nose points straight up or down.
pub(super) fn forward(attitude: Attitude) -> Complex<f64> {
    let [_, axis, _] = attitude.axes(Complex::new(1.0, 0.0)).horizontal;
    let size = libm::sqrt(axis.norm_sqr());
    if size > 1e-3 { axis / size } else { Complex::new(0.0, 0.0) }
}

/// Returns the acceleration (V H', V') of a vehicle that moves in the direction of its nose.
///
/// The acceleration is in the level frame, m/s². V is the speed of the vehicle and H' its turn
/// rate.
pub(super) fn vehicle_acceleration_m_s2(
    attitude: Attitude,
    centripetal_m_s2: f64,
    speed_rate_m_s2: f64,
) -> Complex<f64> {
    let clamped = |x: f64| x.clamp(-MAX_FORCE_M_S2, MAX_FORCE_M_S2);
    // The rightward direction is the forward direction rotated by −90°.
    forward(attitude) * Complex::new(clamped(speed_rate_m_s2), -clamped(centripetal_m_s2))
}

/// Returns the point w in the level frame that corrects a small tilt. The point is half the tilt.
pub(super) fn level_correction(tilt_rad: Complex<f64>) -> Complex<f64> {
    tilt_rad * 0.5
}

/// Returns the tilt (rad) for which gravity would cause the given horizontal acceleration.
pub(super) fn tilt_from_acceleration(unexplained_m_s2: Complex<f64>) -> Complex<f64> {
    unexplained_m_s2 / GRAVITY_M_S2
}

/// Returns the gyro error that would cause a tilt of the level.
///
/// The result is a rotation vector in body axes, rad. Its horizontal part in the level frame is j
/// times the tilt.
pub(super) fn gyro_error_from_tilt(attitude: Attitude, tilt_rad: Complex<f64>) -> Vector3<f64> {
    let excess = J * tilt_rad;
    Vector3::from(
        attitude.axes(Complex::new(1.0, 0.0)).horizontal.map(|axis| axis.re * excess.re + axis.im * excess.im),
    )
}
