//! Accelerometer stages: compute the measured up direction from the specific force.
//!
//! Input: specific force in body axes.
//!
//! Output: the point w_acc, with |w_acc| ≤ 1 in one of the charts.
//!
//! Failure: if the force is too small to have a direction, the previous point is kept with trust 0.
//! A force that is not finite counts as zero.
//!
//! | stage | method |
//! | --- | --- |
//! | [`projector`](projector::Projector) | projects the direction of the force |
//! | [`inclinometer-matrix`] | pitch and roll by arctangents, then the point of these angles |
//! | `inclinometer-quaternion` | quaternion of pitch and roll, then the point of its up vector |
//!
//! All three yield the same point at different computational cost.
//!
//! [`inclinometer-matrix`]: inclinometer::Inclinometer

mod inclination;
pub mod inclinometer;
pub mod projector;

pub(crate) use inclination::MAX_PLAUSIBLE_FORCE_M_S2;
pub use inclination::{Inclination, MIN_FORCE_M_S2};
pub use projector::Projector;

use crate::{
    Vector3,
    point::Point,
    stage::{RestoreError, Stage},
};
use inclinometer::Inclinometer;

/// Accelerometer stage.
#[derive(Debug, Clone, PartialEq)]
pub enum Accelerometer {
    /// `projector`
    Projector(Projector),
    /// `inclinometer-matrix`, `inclinometer-quaternion`
    Inclinometer(Inclinometer),
}

impl Accelerometer {
    /// Names of the stages; the first is the default.
    pub const NAMES: [&'static str; 3] = ["projector", "inclinometer-matrix", "inclinometer-quaternion"];

    /// Creates the stage with the given name, or returns `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "projector" => Some(Self::Projector(Projector::default())),
            "inclinometer-matrix" => Some(Self::Inclinometer(Inclinometer::matrix())),
            "inclinometer-quaternion" => Some(Self::Inclinometer(Inclinometer::quaternion())),
            _ => None,
        }
    }
}

macro_rules! each {
    ($accelerometer:expr, $stage:ident => $do:expr) => {
        match $accelerometer {
            Accelerometer::Projector($stage) => $do,
            Accelerometer::Inclinometer($stage) => $do,
        }
    };
}

impl Stage for Accelerometer {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Latest measured up direction.
    type Common = Point;

    fn name(&self) -> &'static str {
        each!(self, stage => stage.name())
    }

    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        each!(self, stage => stage.step(force_m_s2))
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        each!(self, stage => stage.visit_state(visit));
    }

    fn validation_error(&self) -> Option<&'static str> {
        each!(self, stage => stage.validation_error())
    }

    fn common(&self) -> Point {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(up))
    }
}
