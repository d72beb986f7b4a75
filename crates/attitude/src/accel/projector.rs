//! Accelerometer stage `projector`, which projects the direction of the force.

use super::inclination::{Inclination, MIN_FORCE_M_S2, finite_or_zero, trust};
use crate::{
    Vector3,
    point::Point,
    scalars::visit_fields,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

/// Accelerometer stage `projector` — Matveev 2025, (27), (28).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Projector {
    up: Point,
}

impl Stage for Projector {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Latest measured up direction.
    type Common = Point;

    fn name(&self) -> &'static str {
        "projector"
    }

    #[inline]
    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let force_m_s2 = finite_or_zero(force_m_s2);
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let usable = (MIN_FORCE_M_S2..f64::MAX).contains(&norm_m_s2);
        if usable {
            self.up = Point::from_direction_and_norm(force_m_s2, norm_m_s2);
        }
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust: trust(norm_m_s2, usable) }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: up);
    }
    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(Attitude::from_up(self.up))
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        Attitude::from_up(*up).validate()?;
        self.up = *up;
        Ok(())
    }
}
