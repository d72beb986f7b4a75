//! Plausibility limits of force, rate, speed and interval of a vehicle, and the accuracy limit of
//! levelling.

use crate::{
    Vector3,
    gnss::{Fix, MAX_SPEED_M_S},
    gyro::Motion,
};

/// Maximum force or acceleration of a vehicle, m/s². Larger values are clamped.
pub(super) const MAX_FORCE_M_S2: f64 = 500.0;
/// Maximum rate of a vehicle, rad/s. Larger values are clamped.
pub(super) const MAX_RATE_RAD_S: f64 = 100.0;
/// Smallest standard deviation of the inclination, rad.
///
/// Levelling cannot observe the bias of a consumer accelerometer, 0.02 m/s², which causes this
/// tilt.
pub(super) const MIN_INCLINATION_SD_RAD: f64 = 0.002;

/// Returns the length of the tick's interval, s.
pub(super) fn interval_s(motion: Option<&Motion>) -> f64 {
    motion.map_or(0.0, |motion| motion.dt_s.clamp(0.0, 1.0))
}

/// Returns the fix if its velocity is plausible.
pub(super) fn plausible_fix(fix: Option<&Fix>) -> Option<&Fix> {
    fix.filter(|fix| fix.velocity_m_s.amax() <= MAX_SPEED_M_S)
}

/// Scales a vector down such that no component exceeds `limit`; the direction is kept.
pub(super) fn limited(vector: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let size = vector.amax();
    if size > limit { vector * (limit / size) } else { vector }
}
