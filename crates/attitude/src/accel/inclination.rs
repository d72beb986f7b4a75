//! Output of the accelerometer stages: the measured up direction and a measure of how far the force
//! is trusted.

use crate::{
    GRAVITY_M_S2, Vector3,
    flags::Flags,
    point::Point,
    scalars::{are_finite, scalars},
    stage::{Validate, attitude_validation_error},
    state::Attitude,
};

/// Largest plausible specific force, m/s² (300 g).
pub(crate) const MAX_PLAUSIBLE_FORCE_M_S2: f64 = 3000.0;
/// Smallest usable force, m/s². Below it, near free fall, the direction of the force is noise.
pub const MIN_FORCE_M_S2: f64 = 0.5;

/// Measured up direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Inclination {
    /// Measured up direction, as the point w_acc.
    pub up: Point,
    /// Specific force in body axes, m/s².
    pub force_m_s2: Vector3<f64>,
    /// Norm |f| of the force, m/s².
    pub norm_m_s2: f64,
    /// Degree to which the force is trusted, 0 to 1.
    ///
    /// The trust is 1 at |f| = g and decreases linearly to 0 at |f| = 0 and at |f| = 2 g or more.
    /// The trust is also 0 if `up` was not computed from this force, and rates a single instant
    /// only. To suppress forces due to motion, averaging works better than rejecting samples with
    /// low trust.
    pub trust: f64,
}

impl Inclination {
    /// Returns [`Flags::FORCE_SMALL`] if the force is too small to have a direction.
    #[inline]
    pub fn flags(&self) -> Flags {
        Flags::FORCE_SMALL.when(self.norm_m_s2 < MIN_FORCE_M_S2)
    }
}

impl Validate for Inclination {
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let Self { up, force_m_s2, norm_m_s2, trust } = self;
        let finite = are_finite([force_m_s2.x, force_m_s2.y, force_m_s2.z, *norm_m_s2]);
        let valid_trust = (0.0..=1.0).contains(trust);
        attitude_validation_error(Attitude::from_up(*up))
            .or((!finite).then_some("a number that is not finite"))
            .or((!valid_trust).then_some("a trust outside 0 to 1"))
    }
}

scalars!(Inclination: up, force_m_s2, norm_m_s2, trust);

/// Returns the degree to which a force is trusted, 0 to 1.
///
/// The trust is 1 at |f| = g and decreases linearly to 0 at |f| = 0 and at |f| = 2 g or more. A
/// force that was not used has trust 0.
#[inline]
pub(super) fn trust(norm_m_s2: f64, used: bool) -> f64 {
    let deviation = (norm_m_s2 * (1.0 / GRAVITY_M_S2) - 1.0).abs();
    if used { (1.0 - deviation).max(0.0) } else { 0.0 }
}

/// Returns the force, or zero if it is not finite.
#[inline]
pub(super) fn finite_or_zero(force_m_s2: &Vector3<f64>) -> Vector3<f64> {
    if are_finite((*force_m_s2).into()) { *force_m_s2 } else { Vector3::zeros() }
}
