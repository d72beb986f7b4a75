//! From the attitude of one stage to that of another without a step.
//!
//! Input: attitudes of both. Output: an attitude that goes on where it was, and what is left between the two is taken back by and by.
//! Time: the tick's interval. Failure: none; what is more than that should hide jumps, and those who ask are told.

use crate::{
    Complex, Quaternion,
    fuser::leaky_velocity::LeakyVelocity,
    numbers::Numbers,
    state::{Attitude, wrapped_rad},
};

/// More than this jumps, rad: 1°.
const JUMP_RAD: f64 = 0.017_453_293;
/// Time constant at which it is taken back, s, and most in a tick, rad: 0.01°.
const EASE_S: f64 = 0.5;
const STEP_MAX_RAD: f64 = 1.745_329_3e-4;

/// What is added to the attitude of the stage that gives the level.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Transition {
    /// About the vertical, rad.
    heading_rad: f64,
    /// About east and north, rad, on top of it.
    tilt_rad: Complex<f64>,
}

impl Transition {
    pub(super) fn attitude(&self, level: Attitude) -> Attitude {
        let turned = Attitude { z_rad: wrapped_rad(level.z_rad + self.heading_rad), ..level };
        if self.tilt_rad.norm_sqr() == 0.0 {
            return turned;
        }
        let half = self.tilt_rad * 0.5;
        let tilt = Quaternion::new(libm::sqrt(1.0 - half.norm_sqr()), half.re, half.im, 0.0);
        Attitude::of_quaternion(tilt * turned.quaternion())
    }

    /// A horizontal velocity of the stage that gives the level, as the attitude has it.
    pub(super) fn turned(&self, velocity: LeakyVelocity) -> LeakyVelocity {
        velocity.turned(self.heading_rad)
    }

    /// Another stage gives the level from now on: the attitude goes on, or jumps where the levels are too far apart, and this is true.
    pub(super) fn begin(&mut self, old: Attitude, new: Attitude) -> bool {
        let apart = self.attitude(old).quaternion() * new.quaternion().conjugate();
        self.heading_rad = about_vertical_rad(apart);
        let (sin, cos) = libm::sincos(0.5 * self.heading_rad);
        let tilt = apart * Quaternion::new(cos, 0.0, 0.0, -sin);
        let sign = if tilt.w < 0.0 { -2.0 } else { 2.0 };
        let tilt_rad = Complex::new(tilt.i, tilt.j) * sign;
        let jumps = tilt_rad.norm_sqr() > JUMP_RAD * JUMP_RAD;
        self.tilt_rad = if jumps { Complex::new(0.0, 0.0) } else { tilt_rad };
        jumps
    }

    /// The heading is drawn to that of the attitude `heading`, where another stage gives it than the level; true where that is so far
    /// that it jumps.
    pub(super) fn follow_heading(&mut self, level: Attitude, heading: Option<Attitude>, dt_s: f64) -> bool {
        let wanted_rad =
            heading.map_or(0.0, |heading| about_vertical_rad(heading.quaternion() * level.quaternion().conjugate()));
        let rest_rad = wrapped_rad(wanted_rad - self.heading_rad);
        let jumps = rest_rad.abs() > JUMP_RAD;
        let step_rad = if jumps { rest_rad } else { rest_rad * share(rest_rad * rest_rad, dt_s) };
        self.heading_rad = wrapped_rad(self.heading_rad + step_rad);
        jumps
    }

    /// The tilt is taken back.
    pub(super) fn ease(&mut self, dt_s: f64) {
        self.tilt_rad -= self.tilt_rad * share(self.tilt_rad.norm_sqr(), dt_s);
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let held = self.heading_rad.abs() <= 4.0 && self.tilt_rad.norm_sqr() <= 2.0 * JUMP_RAD * JUMP_RAD;
        (!held).then_some("a transition of more than it takes back")
    }
}

impl Numbers for Transition {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.heading_rad.visit(visit);
        self.tilt_rad.visit(visit);
    }
}

/// How much of a rest of this square, rad², is taken back in a tick.
fn share(rest2_rad2: f64, dt_s: f64) -> f64 {
    let share = (dt_s / EASE_S).min(1.0);
    if rest2_rad2 * (share * share) > STEP_MAX_RAD * STEP_MAX_RAD {
        STEP_MAX_RAD / libm::sqrt(rest2_rad2)
    } else {
        share
    }
}

/// The part about the vertical of a rotation that is followed by one about a horizontal axis, rad.
fn about_vertical_rad(rotation: Quaternion<f64>) -> f64 {
    wrapped_rad(2.0 * libm::atan2(rotation.k, rotation.w))
}
