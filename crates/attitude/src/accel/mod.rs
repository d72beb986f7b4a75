//! Accelerometer stages: from the specific force to the point where up seems to be.
//!
//! Input: specific force in body axes. Output: the point w_acc, with |w_acc| ≤ 1 in one of the charts. Time: none.
//! Failure: a force without a direction keeps the last point and is given no trust; one that is not finite is none.
//!
//! | stage | what it is |
//! | --- | --- |
//! | [`projector`](projector::Projector) | the direction of the force, projected |
//! | [`inclinometer-matrix`](inclinometer::Inclinometer) | pitch and roll by arctangents, then the point of these angles |
//! | `inclinometer-quaternion` | the quaternion of pitch and roll, then the point of its up vector |
//!
//! All three see the same point; they differ in what it costs.

mod inclination;
pub mod inclinometer;
pub mod projector;

pub use inclination::{FORCE_MIN_M_S2, Inclination};
pub use projector::Projector;

use crate::{
    Vector3,
    point::Point,
    stage::{RestoreError, Stage},
};
use inclinometer::Inclinometer;

/// An accelerometer stage.
#[derive(Debug, Clone, PartialEq)]
pub enum Accelerometer {
    /// `projector`
    Projector(Projector),
    /// `inclinometer-matrix`, `inclinometer-quaternion`
    Inclinometer(Inclinometer),
}

impl Accelerometer {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 3] = ["projector", "inclinometer-matrix", "inclinometer-quaternion"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
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
    /// Where up seemed to be last.
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

    fn flaw(&self) -> Option<&'static str> {
        each!(self, stage => stage.flaw())
    }

    fn common(&self) -> Point {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, up: &Point) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(up))
    }
}
