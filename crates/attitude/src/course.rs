//! The course stage: from the attitude to what people read.
//!
//! Input: an attitude. Output: yaw, pitch, roll — Matveev 2025, (23)–(25) — the course, and the quaternion. Time: none.
//! Failure: near the vertical yaw and roll lose their meaning, and the output says so.

use core::f64::consts::TAU;

use crate::{Quaternion, angles::Angles, stage::Stage, state::Attitude};

/// |pitch| from which yaw and roll are no longer told apart, rad: 89°.
const GIMBAL_RAD: f64 = 1.553_343_034_274_953_3;

/// The attitude as people read it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Yaw, pitch, roll.
    pub angles: Angles,
    /// Course H = −ψ, rad, clockwise from above, [0, 2π), from wherever the reference η0 axis points.
    pub course_rad: f64,
    /// Body → reference; its sign is that of the reading before, so that it does not jump.
    pub quaternion: Quaternion<f64>,
    /// Yaw and roll are not told apart here.
    pub near_gimbal: bool,
}

/// The course stage `angles`.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    before: Quaternion<f64>,
}

impl Course {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 1] = ["angles"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        (name == "angles").then(|| Self { before: Quaternion::new(1.0, 0.0, 0.0, 0.0) })
    }
}

impl Stage for Course {
    type Input = Attitude;
    type Output = Reading;

    fn name(&self) -> &'static str {
        "angles"
    }

    fn step(&mut self, attitude: &Attitude) -> Reading {
        let angles = attitude.angles();
        let q = attitude.quaternion();
        let quaternion = if q.dot(&self.before) < 0.0 { -q } else { q };
        self.before = quaternion;
        let course_rad = if angles.yaw_rad > 0.0 { TAU - angles.yaw_rad } else { 0.0 - angles.yaw_rad };
        // A yaw too small to be seen beside 2π.
        let course_rad = if course_rad < TAU { course_rad } else { 0.0 };
        Reading { angles, course_rad, quaternion, near_gimbal: libm::fabs(angles.pitch_rad) > GIMBAL_RAD }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.before.coords.iter_mut().for_each(visit);
    }
}
