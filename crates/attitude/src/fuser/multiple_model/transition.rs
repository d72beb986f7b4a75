//! Transition from the attitude of one stage to that of another without a step.
//!
//! Input: the attitudes of both stages.
//!
//! Output: a continuous attitude; the remaining difference is removed gradually.
//!
//! Time: the interval of the tick.
//!
//! Failure: a difference that is too large for a gradual transition causes a jump, which is
//! reported to the caller.

use crate::{
    Complex, Quaternion,
    fuser::leaky_velocity::LeakyVelocity,
    scalars::scalars,
    state::{Attitude, wrapped_rad},
};

/// Largest difference between the stages' attitudes that is removed gradually, rad (1°). A larger
/// difference causes a jump.
const MIN_JUMP_RAD: f64 = 0.017_453_293;
/// Time constant with which the difference between the attitudes is removed, s.
const BLEND_TIME_CONSTANT_S: f64 = 0.5;
/// Largest part of the difference that is removed in one tick, rad (0.01°).
const MAX_STEP_RAD: f64 = 1.745_329_3e-4;

/// Rotation from the attitude of the stage that provides the level to the output attitude.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Transition {
    /// Rotation about the vertical, rad.
    heading_rad: f64,
    /// Rotation (rad) about east and north, applied after the rotation about the vertical.
    tilt_rad: Complex<f64>,
}

impl Transition {
    #[inline]
    pub(super) fn attitude(&self, level: Attitude) -> Attitude {
        let rotated = Attitude { z_rad: wrapped_rad(level.z_rad + self.heading_rad), ..level };
        if self.tilt_rad.norm_sqr() == 0.0 {
            return rotated;
        }
        let half = self.tilt_rad * 0.5;
        let tilt = Quaternion::new(libm::sqrt(1.0 - half.norm_sqr()), half.re, half.im, 0.0);
        Attitude::from_quaternion(tilt * rotated.quaternion())
    }

    /// Rotates a horizontal velocity into the output frame from the frame of the stage that
    /// provides the level.
    pub(super) fn rotate_velocity(&self, velocity: LeakyVelocity) -> LeakyVelocity {
        velocity.rotated(self.heading_rad)
    }

    /// Starts a transition of the level from `old` to `new`. Returns `true` if the level jumps
    /// because the difference is too large.
    pub(super) fn start(&mut self, old: Attitude, new: Attitude) -> bool {
        let difference = self.attitude(old).quaternion() * new.quaternion().conjugate();
        self.heading_rad = about_vertical_rad(difference);
        let (sin, cos) = libm::sincos(0.5 * self.heading_rad);
        let tilt = difference * Quaternion::new(cos, 0.0, 0.0, -sin);
        let sign = if tilt.w < 0.0 { -2.0 } else { 2.0 };
        let tilt_rad = Complex::new(tilt.i, tilt.j) * sign;
        let jumps = tilt_rad.norm_sqr() > MIN_JUMP_RAD * MIN_JUMP_RAD;
        self.tilt_rad = if jumps { Complex::new(0.0, 0.0) } else { tilt_rad };
        jumps
    }

    /// Moves the heading of the output towards that of the attitude `heading`.
    ///
    /// If `heading` is `None`, the output heading moves towards that of the level stage. Returns
    /// `true` if the heading jumps because the difference is too large.
    #[inline]
    pub(super) fn follow_heading(&mut self, level: Attitude, heading: Option<Attitude>, dt_s: f64) -> bool {
        if heading.is_none() && self.heading_rad == 0.0 {
            return false;
        }
        let target_rad =
            heading.map_or(0.0, |heading| about_vertical_rad(heading.quaternion() * level.quaternion().conjugate()));
        let remaining_rad = wrapped_rad(target_rad - self.heading_rad);
        let jumps = remaining_rad.abs() > MIN_JUMP_RAD;
        let step_rad =
            if jumps { remaining_rad } else { remaining_rad * blend_gain(remaining_rad * remaining_rad, dt_s) };
        self.heading_rad = wrapped_rad(self.heading_rad + step_rad);
        jumps
    }

    /// Removes a part of the remaining tilt in one tick.
    #[inline]
    pub(super) fn decay_tilt(&mut self, dt_s: f64) {
        if self.tilt_rad.norm_sqr() == 0.0 {
            return;
        }
        self.tilt_rad -= self.tilt_rad * blend_gain(self.tilt_rad.norm_sqr(), dt_s);
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let in_range = self.heading_rad.abs() <= 4.0 && self.tilt_rad.norm_sqr() <= 2.0 * MIN_JUMP_RAD * MIN_JUMP_RAD;
        (!in_range).then_some("a transition out of range")
    }
}

scalars!(Transition: heading_rad, tilt_rad);

/// Returns the fraction of the remaining angle that is removed in one tick. `remaining2_rad2` is
/// the square of the angle, rad².
fn blend_gain(remaining2_rad2: f64, dt_s: f64) -> f64 {
    let gain = (dt_s / BLEND_TIME_CONSTANT_S).min(1.0);
    if remaining2_rad2 * (gain * gain) > MAX_STEP_RAD * MAX_STEP_RAD {
        MAX_STEP_RAD / libm::sqrt(remaining2_rad2)
    } else {
        gain
    }
}

/// Returns the angle by which `rotation` turns the body about the vertical, rad.
///
/// `rotation` is split into a rotation about the vertical, followed by one about a horizontal axis.
fn about_vertical_rad(rotation: Quaternion<f64>) -> f64 {
    wrapped_rad(2.0 * libm::atan2(rotation.k, rotation.w))
}
