//! The accelerometer stage `projector`.

use super::inclination::{FORCE_MIN_M_S2, Inclination, finite, trust};
use crate::{
    Vector3,
    numbers::Numbers,
    point::Point,
    stage::{RestoreError, Stage, attitude_flaw},
    state::Attitude,
};

/// The accelerometer stage `projector` — Matveev 2025, (27), (28).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Projector {
    up: Point,
}

impl Stage for Projector {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Where up seemed to be last.
    type Common = Point;

    fn name(&self) -> &'static str {
        "projector"
    }

    #[inline]
    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let force_m_s2 = finite(force_m_s2);
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let known = (FORCE_MIN_M_S2..f64::MAX).contains(&norm_m_s2);
        if known {
            self.up = Point::of_known_norm(force_m_s2, norm_m_s2);
        }
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust: trust(norm_m_s2, known) }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.up.visit(visit);
    }
    fn flaw(&self) -> Option<&'static str> {
        attitude_flaw(Attitude::levelled(self.up))
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        Attitude::levelled(*up).checked()?;
        self.up = *up;
        Ok(())
    }
}
