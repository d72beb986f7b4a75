//! Stage `@name@` for the slot accel: the measured up direction, from the specific force.
//!
//! Input: specific force in body axes.
//!
//! Output: the direction of the force and a trust value from 0 to 1.
//!
//! Failure: if a force has no direction, the previous point is kept, with trust 0. A non-finite
//! force counts as zero.

use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::{Inclination, MIN_FORCE_M_S2},
    parameters::{Parameter, ParameterError, Parameters, settings},
    point::Point,
    scalars::Scalars,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};

settings! {
    /// Settings of the stage.
    pub struct Settings {
        /// Difference from gravity at which the trust in a force is zero.
        zero_trust_difference_g: 0.5 in 0.001 .. 10.0, "g";
    }
}

/// Stage that reports the direction of the force.
///
/// The trust decreases as the magnitude of the force departs from gravity.
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
        let is_finite = force_m_s2.iter().all(|x| x.is_finite());
        let force_m_s2 = if is_finite { *force_m_s2 } else { Vector3::zeros() };
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let up = Point::from_direction(force_m_s2).filter(|_| norm_m_s2 >= MIN_FORCE_M_S2);
        self.up = up.unwrap_or(self.up);
        let difference_g = (norm_m_s2 / GRAVITY_M_S2 - 1.0).abs();
        let trust = up.map_or(0.0, |_| (1.0 - difference_g / self.settings.zero_trust_difference_g).max(0.0));
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
