//! The stage `@name@` for the slot accel: where up seems to be, from the specific force.
//!
//! Input: the specific force in body axes. Output: where it points, and how far to trust it. Time: none. Failure: a force without a
//! direction keeps the last point and is given no trust; one that is not a number is none.

use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::{MIN_FORCE_M_S2, Inclination},
    scalars::Scalars,
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

settings! {
    /// Settings of the stage.
    pub struct Settings {
        /// Difference from gravity at which a force is no longer trusted.
        distrusted_g: 0.5 in 0.001 .. 10.0, "g";
    }
}

/// Up is where the force points, trusted as far as the force is as large as gravity.
#[derive(Debug, Clone, Default)]
pub struct @Class@ {
    settings: Settings,
    up: Point,
}

impl Stage for @Class@ {
    type Input = Vector3<f64>;
    type Output = Inclination;
    type Common = Point;

    fn name(&self) -> &'static str {
        "@name@"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let known = force_m_s2.iter().all(|x| x.is_finite());
        let force_m_s2 = if known { *force_m_s2 } else { Vector3::zeros() };
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let seen = Point::from_direction(force_m_s2).filter(|_| norm_m_s2 >= MIN_FORCE_M_S2);
        self.up = seen.unwrap_or(self.up);
        let off_g = (norm_m_s2 / GRAVITY_M_S2 - 1.0).abs();
        let trust = seen.map_or(0.0, |_| (1.0 - off_g / self.settings.distrusted_g).max(0.0));
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.up.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        attitude_validation_error(Attitude::from_up(self.up))
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, common: &Point) -> Result<(), RestoreError> {
        Attitude::from_up(*common).validate()?;
        self.up = *common;
        Ok(())
    }
}
