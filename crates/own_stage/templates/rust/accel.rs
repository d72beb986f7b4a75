//! The stage `@name@` for the slot accel: where up seems to be, from the specific force.
//!
//! Input: the specific force in body axes. Output: where it points, and how far to trust it. Time: none. Failure: a force without a
//! direction keeps the last point and is given no trust; one that is not a number is none.

use attitude::{
    GRAVITY_M_S2, Vector3,
    accel::{FORCE_MIN_M_S2, Inclination},
    parameters::{Parameter, ParameterError},
    point::{Chart, Point},
    stage::{RestoreError, Stage},
};

/// The name by which it is chosen.
pub const NAME: &str = "@name@";

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "distrusted_g",
    unit: "g",
    default: 0.5,
    least: 0.001,
    most: 10.0,
    about: "Difference from gravity at which a force is no longer trusted.",
}];

/// Up is where the force points, trusted as far as the force is as large as gravity.
#[derive(Debug, Clone)]
pub struct @Class@ {
    distrusted_g: f64,
    up: Point,
}

impl Default for @Class@ {
    fn default() -> Self {
        Self { distrusted_g: PARAMETERS[0].default, up: Point::default() }
    }
}

impl Stage for @Class@ {
    type Input = Vector3<f64>;
    type Output = Inclination;
    type Common = Point;

    fn name(&self) -> &'static str {
        NAME
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let known = PARAMETERS.iter().find(|parameter| parameter.name == name);
        let parameter = known.ok_or(ParameterError::Unknown { known: PARAMETERS })?;
        if !(parameter.least..=parameter.most).contains(&value) {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.distrusted_g = value;
        Ok(())
    }

    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let number = force_m_s2.iter().all(|x| x.is_finite());
        let force_m_s2 = if number { *force_m_s2 } else { Vector3::zeros() };
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let seen = Point::of(force_m_s2).filter(|_| norm_m_s2 >= FORCE_MIN_M_S2);
        self.up = seen.unwrap_or(self.up);
        let off_g = (norm_m_s2 / GRAVITY_M_S2 - 1.0).abs();
        let trust = seen.map_or(0.0, |_| (1.0 - off_g / self.distrusted_g).max(0.0));
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut inverted = f64::from(self.up.chart as u8);
        visit(&mut self.up.w.re);
        visit(&mut self.up.w.im);
        visit(&mut inverted);
        self.up.chart = if inverted > 0.5 { Chart::Inverted } else { Chart::Upright };
    }

    fn flaw(&self) -> Option<&'static str> {
        flaw(self.up)
    }

    fn common(&self) -> Point {
        self.up
    }

    fn adopt(&mut self, common: &Point) -> Result<(), RestoreError> {
        flaw(*common).map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))?;
        self.up = *common;
        Ok(())
    }
}

/// What is wrong with a point; one that is not a number is inside nothing.
fn flaw(up: Point) -> Option<&'static str> {
    let inside = up.w.norm_sqr() <= 2.0;
    (!inside).then_some("a point outside its chart")
}
