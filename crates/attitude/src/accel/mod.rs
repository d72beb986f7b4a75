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
//! | `projector` | projects the direction of the force — Matveev 2025, (27), (28) |
//! | `inclinometer-matrix` | pitch and roll by arctangents, then the point of these angles |
//! | `inclinometer-quaternion` | quaternion of pitch and roll, then the point of its up vector |
//!
//! All three yield the same point at different computational cost.

mod inclination;
mod inclinometer;

pub(crate) use inclination::MAX_PLAUSIBLE_FORCE_M_S2;
pub use inclination::{Inclination, MIN_FORCE_M_S2};

use crate::{
    Vector3,
    point::Point,
    scalars::visit_fields,
    stage::{RestoreError, Stage, attitude_validation_error},
    state::Attitude,
};
use {
    inclination::{finite_or_zero, trust},
    inclinometer::{point_by_matrix, point_by_quaternion},
};

/// Method of computing the point from the force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Method {
    #[default]
    Projection,
    Matrix,
    Quaternion,
}

/// Accelerometer stage. The default is `projector`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Accelerometer {
    method: Method,
    up: Point,
}

impl Accelerometer {
    /// Names of the stages; the first is the default.
    pub const NAMES: [&'static str; 3] = ["projector", "inclinometer-matrix", "inclinometer-quaternion"];

    /// Creates the stage with the given name, or returns `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        let method = match name {
            "projector" => Method::Projection,
            "inclinometer-matrix" => Method::Matrix,
            "inclinometer-quaternion" => Method::Quaternion,
            _ => return None,
        };
        Some(Self { method, up: Point::default() })
    }
}

impl Stage for Accelerometer {
    type Input = Vector3<f64>;
    type Output = Inclination;
    /// Latest measured up direction.
    type Common = Point;

    fn name(&self) -> &'static str {
        match self.method {
            Method::Projection => "projector",
            Method::Matrix => "inclinometer-matrix",
            Method::Quaternion => "inclinometer-quaternion",
        }
    }

    #[inline(always)]
    fn step(&mut self, force_m_s2: &Vector3<f64>) -> Inclination {
        let force_m_s2 = finite_or_zero(force_m_s2);
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let is_usable = (MIN_FORCE_M_S2..f64::MAX).contains(&norm_m_s2);
        let point = match self.method {
            _ if !is_usable => None,
            Method::Projection => Some(Point::from_direction_and_norm(force_m_s2, norm_m_s2)),
            Method::Matrix => point_by_matrix(force_m_s2),
            Method::Quaternion => Some(point_by_quaternion(force_m_s2)),
        };
        self.up = point.unwrap_or(self.up);
        Inclination { up: self.up, force_m_s2, norm_m_s2, trust: trust(norm_m_s2, point.is_some()) }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: up; without method);
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
