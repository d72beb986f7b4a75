//! The pull of one force on the level.

use super::limits::{FORCE_LIMIT_M_S2, bounded};
use crate::{Complex, accel::Inclination, state::Attitude};

/// Longest time for which one force stands, s; over a longer one nothing is levelled.
const FORCE_HOLD_S: f64 = 1.0;

/// What one force says, over the time for which it stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    /// Horizontal part in the level frame, m/s².
    pub(super) level_m_s2: Complex<f64>,
    /// For how long, s; zero over a time that is too long for one force.
    pub(super) dt_s: f64,
}

impl Pull {
    pub(super) fn of(attitude: Attitude, inclination: &Inclination, unlevelled_s: f64) -> Self {
        let dt_s = if unlevelled_s > FORCE_HOLD_S { 0.0 } else { unlevelled_s };
        Self { level_m_s2: attitude.horizontal(bounded(inclination.force_m_s2, FORCE_LIMIT_M_S2)), dt_s }
    }
}
