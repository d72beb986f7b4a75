//! Limits of what a vehicle's force, rate, speed and interval can be, and of the tilt that levelling can see.

use crate::{Vector3, gnss::Fix, gyro::Motion};

/// A force, an acceleration beyond this is no vehicle's, m/s².
pub(super) const FORCE_LIMIT_M_S2: f64 = 500.0;
/// A rate beyond this is no vehicle's, rad/s.
pub(super) const RATE_LIMIT_RAD_S: f64 = 100.0;
/// A speed beyond this is no vehicle's, m/s.
const SPEED_LIMIT_M_S: f64 = 3000.0;
/// The tilt that the bias of a consumer accelerometer makes, 0.02 m/s²; no levelling can see it, rad.
pub(super) const FLOOR_RAD: f64 = 0.002;

/// The length of the tick's interval, s.
pub(super) fn interval_s(motion: Option<&Motion>) -> f64 {
    motion.map_or(0.0, |motion| motion.dt_s.clamp(0.0, 1.0))
}

/// The fix, if its velocity can be one.
pub(super) fn credible(fix: Option<&Fix>) -> Option<&Fix> {
    fix.filter(|fix| fix.velocity_m_s.amax() <= SPEED_LIMIT_M_S)
}

/// A vector whose components are at most `limit`, in its own direction.
pub(super) fn bounded(vector: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let size = vector.amax();
    if size > limit { vector * (limit / size) } else { vector }
}
