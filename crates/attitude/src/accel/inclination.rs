//! An inclination, which every accelerometer stage gives, and how far a force is trusted.

use crate::{
    GRAVITY_M_S2, Vector3,
    numbers::Numbers,
    point::Point,
    stage::{Sound, attitude_flaw},
    state::Attitude,
};

/// Below this the direction of the force is noise, m/s²: free fall.
pub const FORCE_MIN_M_S2: f64 = 0.5;

/// Where up seems to be.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Inclination {
    /// w_acc.
    pub up: Point,
    /// The specific force, m/s², body axes.
    pub force_m_s2: Vector3<f64>,
    /// |f|, m/s².
    pub norm_m_s2: f64,
    /// 1 at |f| = g, falling to 0 at a difference of g; 0 where `up` is not from this force. It judges the instant only: to
    /// leave out what moves is a worse filter than to average it.
    pub trust: f64,
}

impl Sound for Inclination {
    fn flaw(&self) -> Option<&'static str> {
        let Self { up, force_m_s2, norm_m_s2, trust } = self;
        let finite = force_m_s2.iter().chain([norm_m_s2]).all(|number| number.is_finite());
        let trusted = (0.0..=1.0).contains(trust);
        attitude_flaw(Attitude::levelled(*up))
            .or((!finite).then_some("a number that is not finite"))
            .or((!trusted).then_some("a trust outside 0 to 1"))
    }
}

impl Numbers for Inclination {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { up, force_m_s2, norm_m_s2, trust } = self;
        up.visit(visit);
        force_m_s2.visit(visit);
        [norm_m_s2, trust].into_iter().for_each(visit);
    }
}

/// 1 at |f| = g, falling to 0 at a difference of g; 0 for a force that was not used.
#[inline]
pub(super) fn trust(norm_m_s2: f64, used: bool) -> f64 {
    let off = (norm_m_s2 * (1.0 / GRAVITY_M_S2) - 1.0).abs();
    if used { (1.0 - off).max(0.0) } else { 0.0 }
}

/// The force; none where it is not finite.
#[inline]
pub(super) fn finite(force_m_s2: &Vector3<f64>) -> Vector3<f64> {
    if force_m_s2.iter().all(|component| component.is_finite()) { *force_m_s2 } else { Vector3::zeros() }
}
