//! Accelerometer stages: from the specific force to the point where up seems to be.
//!
//! Input: specific force in body axes. Output: the point w_acc, with |w_acc| ≤ 1 in one of the charts. Time: none.
//! Failure: a force without a direction keeps the last point and is given no trust.

use crate::{
    GRAVITY_M_S2, Vector3,
    point::Point,
    stage::{Numbers, RestoreError, Stage, attitude_flaw},
    state::Attitude,
};

/// Below this the direction of the force is noise, m/s²: free fall.
pub const FORCE_MIN_M_S2: f64 = 0.5;

/// Where up seems to be.
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// The accelerometer stage `projector` — Matveev 2025, (27), (28).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Projector {
    up: Point,
}

impl Projector {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 1] = ["projector"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        (name == "projector").then(Self::default)
    }
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
        let norm_m_s2 = force_m_s2.norm().min(f64::MAX);
        let known = (FORCE_MIN_M_S2..f64::MAX).contains(&norm_m_s2);
        if known {
            self.up = Point::of_known_norm(*force_m_s2, norm_m_s2);
        }
        let off = (norm_m_s2 * (1.0 / GRAVITY_M_S2) - 1.0).abs();
        let trust = if known { (1.0 - off).max(0.0) } else { 0.0 };
        Inclination { up: self.up, force_m_s2: *force_m_s2, norm_m_s2, trust }
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
