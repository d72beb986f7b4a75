//! Horizontal force used to level the platform.

use super::limits::{MAX_FORCE_M_S2, limited};
use crate::{Complex, accel::Inclination, state::Attitude};

/// Maximum interval covered by one force, s. If the interval is longer, the level is not corrected.
const MAX_FORCE_INTERVAL_S: f64 = 1.0;

/// Horizontal force and the interval that it covers.
#[derive(Debug, Clone, Copy)]
pub(super) struct LevelForce {
    /// Horizontal part in the level frame, m/s².
    pub(super) level_m_s2: Complex<f64>,
    /// Interval, s; zero if it is too long for one force.
    pub(super) dt_s: f64,
}

impl LevelForce {
    pub(super) fn new(attitude: Attitude, inclination: &Inclination, since_force_s: f64) -> Self {
        let dt_s = if since_force_s > MAX_FORCE_INTERVAL_S { 0.0 } else { since_force_s };
        Self { level_m_s2: attitude.horizontal(limited(inclination.force_m_s2, MAX_FORCE_M_S2)), dt_s }
    }
}
