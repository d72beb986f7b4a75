//! Model `wz` with the selection between the two stages.
//!
//! Input: the input of the stage, and the output of the model `aided` at the same tick.
//!
//! Output: the attitude of the selected stages.
//!
//! Time: the interval of the motion.

use super::{aided_model::AidedOutput, transition::Transition};
use crate::{
    course::CourseReference,
    fuser::{
        FuserInput,
        estimate::Estimate,
        fused::{Corrections, Fused},
        wz::Wz,
    },
    scalars::Scalars,
    stage::Stage as _,
    state::Attitude,
};

/// Stage that provides the level or the heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    Wz,
    Aided,
}

/// Stages that provide level and heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ModelSelection {
    level: Model,
    heading: Model,
}

impl ModelSelection {
    const WZ: Self = Self { level: Model::Wz, heading: Model::Wz };

    /// Selects one stage for the level and one for the heading. The choice depends on ground motion
    /// and on the references of the two headings.
    fn new(has_ground_motion: bool, wz: CourseReference, aided: CourseReference) -> Self {
        let heading = match (wz, aided) {
            (CourseReference::Magnetic, CourseReference::True) if !has_ground_motion => Model::Wz,
            (_, CourseReference::True) => Model::Aided,
            _ => Model::Wz,
        };
        Self { level: if has_ground_motion { Model::Aided } else { Model::Wz }, heading }
    }

    fn pick<T>(self, wz: T, aided: T) -> Selected<T>
    where
        T: Copy,
    {
        let value_of = |model| if model == Model::Wz { wz } else { aided };
        Selected { level: value_of(self.level), heading: value_of(self.heading) }
    }
}

/// Values from the stage selected for the level and from the stage selected for the heading.
#[derive(Debug, Clone, Copy)]
struct Selected<T> {
    level: T,
    heading: T,
}

/// Model `wz`: the stage, and the selection between it and `aided`.
#[derive(Debug, Clone, PartialEq)]
pub struct WzModel {
    pub(super) stage: Wz,
    selection: ModelSelection,
    transition: Transition,
}

impl Default for WzModel {
    fn default() -> Self {
        Self { stage: Wz::default(), selection: ModelSelection::WZ, transition: Transition::default() }
    }
}

impl WzModel {
    /// Lets the next inclination re-initialise the level.
    pub fn realign(&mut self) {
        self.stage.realign();
    }

    /// Processes a tick and returns the output of the stage `multiple-model`.
    ///
    /// The input must be finite. `aided` is the output of the model `aided` at this tick.
    #[inline]
    pub fn step(&mut self, input: &FuserInput, aided: Option<&AidedOutput>) -> Fused {
        let wz = self.stage.fuse(input);
        let dt_s = input.motion.as_ref().map_or(0.0, |motion| motion.dt_s);
        let selection = aided.map_or(ModelSelection::WZ, |AidedOutput { has_ground_motion, fused }| {
            ModelSelection::new(*has_ground_motion, wz.reference, fused.reference)
        });
        let previous = core::mem::replace(&mut self.selection, selection);
        let uses_aided = [previous.level, selection.level, selection.heading].contains(&Model::Aided);
        let Some(AidedOutput { fused: aided, .. }) = aided.filter(|_| uses_aided) else {
            return self.combine(&wz, &wz, None, wz.corrections.aligned, dt_s);
        };
        let Selected { level, heading } = selection.pick(&wz, aided);
        let has_switched = previous.level != selection.level;
        let jumps = has_switched && self.transition.start(previous.pick(&wz, aided).level.attitude, level.attitude);
        let other = (selection.level != selection.heading).then_some(heading.attitude);
        self.combine(level, heading, other, level.corrections.aligned || jumps, dt_s)
    }

    /// Returns the output from those of the stages that provide level and heading.
    ///
    /// `other` is the attitude of the stage that provides the heading, if another stage provides
    /// the level. `has_jumped` is `true` if the level jumps.
    #[inline(always)]
    fn combine(
        &mut self,
        level: &Fused,
        heading: &Fused,
        other: Option<Attitude>,
        has_jumped: bool,
        dt_s: f64,
    ) -> Fused {
        let mut aligned = has_jumped;
        if heading.reference != CourseReference::Arbitrary {
            aligned |= self.transition.follow_heading(level.attitude, other, dt_s);
        }
        self.transition.decay_tilt(dt_s);
        Fused {
            attitude: self.transition.attitude(level.attitude),
            heading_sd_rad: heading.heading_sd_rad,
            reference: heading.reference,
            corrections: Corrections {
                velocity: level.corrections.velocity || heading.corrections.velocity,
                magnetic: heading.corrections.magnetic,
                disturbed: heading.corrections.disturbed,
                aligned,
                ..level.corrections
            },
            ..*level
        }
    }

    /// Selects the stages after a hand-over, without a transition.
    pub(super) fn select_again(&mut self, reference: CourseReference, has_ground_motion: bool) {
        self.selection = ModelSelection::new(has_ground_motion, reference, reference);
        self.transition = Transition::default();
    }

    /// Returns the estimate of the stage `multiple-model`. `aided` is that of the other model.
    pub(super) fn common(&self, aided: &Estimate) -> Estimate {
        let wz = self.stage.common();
        let Selected { level, heading } = self.selection.pick(wz, *aided);
        Estimate {
            attitude: self.transition.attitude(level.attitude),
            reference: heading.reference,
            heading_sd_rad: heading.heading_sd_rad,
            gyro_scale: wz.gyro_scale,
            hard_iron: wz.hard_iron,
            leaky_velocity: self.transition.rotate_velocity(level.leaky_velocity),
            ..level
        }
    }

    /// Visits the state without that of the stage.
    pub(super) fn visit_selection(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.selection.visit(visit);
        self.transition.visit(visit);
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        self.stage.validation_error().or_else(|| self.transition.validation_error())
    }
}

impl Scalars for ModelSelection {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for model in [&mut self.level, &mut self.heading] {
            let mut aided = *model == Model::Aided;
            aided.visit(visit);
            *model = if aided { Model::Aided } else { Model::Wz };
        }
    }
}
