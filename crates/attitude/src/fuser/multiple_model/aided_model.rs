//! Model `aided` with the detection of ground motion.
//!
//! Input: the input of the stage.
//!
//! Output: the attitude of `aided` and whether the body moves over ground, if they can be needed.
//!
//! Time: the interval of the motion.

use super::turn_detector::TurnDetector;
use crate::{
    course::CourseReference,
    fuser::{FuserInput, aided::Aided, estimate::Estimate, fused::Fused},
    scalars::Scalars as _,
    stage::Stage as _,
};

/// Time for which a body counts as moving over ground after ground motion was detected, s.
const GROUND_MOTION_HOLD_S: f64 = 300.0;

/// Model `aided`: the stage, and the ground motion that it or the turn detector has detected.
#[derive(Debug, Clone, PartialEq)]
pub struct AidedModel {
    pub(super) stage: Aided,
    turns: TurnDetector,
    /// Time since ground motion was last detected, s.
    since_ground_motion_s: f64,
}

/// Output of [`AidedModel`] at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AidedOutput {
    pub(super) has_ground_motion: bool,
    /// Output of the stage.
    pub(super) fused: Fused,
}

impl Default for AidedModel {
    fn default() -> Self {
        Self { stage: Aided::default(), turns: TurnDetector::default(), since_ground_motion_s: GROUND_MOTION_HOLD_S }
    }
}

impl AidedModel {
    /// Lets the next inclination re-initialise the level.
    pub fn realign(&mut self) {
        self.stage.realign();
        self.turns = TurnDetector::default();
    }

    /// Processes a tick. The input must be finite.
    ///
    /// Returns `None` if `wz` provides level and heading.
    #[inline]
    pub fn step(&mut self, input: &FuserInput) -> Option<AidedOutput> {
        let had_ground_motion = self.has_ground_motion();
        let corrections = self.stage.advance(input);
        let dt_s = input.motion.as_ref().map_or(0.0, |motion| motion.dt_s);
        let reference = self.stage.reference;
        let has_velocity = corrections.velocity && reference == CourseReference::True;
        if self.turns.update(input, self.stage.gyro_bias_rad_s) || has_velocity {
            self.since_ground_motion_s = 0.0;
        } else {
            self.since_ground_motion_s = (self.since_ground_motion_s + dt_s).min(GROUND_MOTION_HOLD_S);
        }
        let has_ground_motion = self.has_ground_motion();
        // The level is that of `aided` during ground motion. At the end of the ground motion, the
        // transition to `wz` starts from the attitude of `aided`.
        let is_needed = had_ground_motion || has_ground_motion || reference == CourseReference::True;
        is_needed.then(|| AidedOutput { has_ground_motion, fused: self.stage.output(input, corrections) })
    }

    /// Returns `true` if ground motion was detected within the last five minutes.
    pub(super) fn has_ground_motion(&self) -> bool {
        self.since_ground_motion_s < GROUND_MOTION_HOLD_S
    }

    pub(super) fn continue_from(&mut self, common: &Estimate) {
        self.stage.continue_from(common);
        self.turns = TurnDetector::default();
        self.since_ground_motion_s = if common.reference == CourseReference::True { 0.0 } else { GROUND_MOTION_HOLD_S };
    }

    /// Visits the state without that of the stage.
    pub(super) fn visit_ground_motion(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.turns.visit(visit);
        self.since_ground_motion_s.visit(visit);
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let time = (self.since_ground_motion_s < 0.0).then_some("a negative time");
        self.stage.validation_error().or_else(|| self.turns.validation_error()).or(time)
    }
}
