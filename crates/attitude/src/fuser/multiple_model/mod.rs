//! Fuser `multiple-model`: two stages on the same input, one per kind of motion, combined into one
//! attitude.
//!
//! `wz` assumes that the mean acceleration over a few seconds is zero, as for a hand, a robot arm
//! or a hovering vehicle. `aided` assumes a persistent velocity, as for aircraft and cars. This
//! velocity is known from a receiver or, if there is none, inferred from turns. Both stages run all
//! the time.
//!
//! Ground motion is detected if a velocity was used while the heading referred to true north, or if
//! a coordinated turn was detected (`turn_detector`). The level is that of `aided` if ground motion
//! was detected within the last five minutes. Otherwise the level is that of `wz`.
//!
//! The heading is that of `aided` if it refers to true north. There is one exception: without
//! ground motion, a heading of `wz` that refers to magnetic north takes precedence. In all other
//! cases the heading is that of `wz`.
//!
//! After a switch between the stages, the difference between their attitudes is removed gradually
//! (`transition`). Only a difference that is too large causes a jump of the attitude.
//!
//! | file | content |
//! | --- | --- |
//! | `turn_detector` | detection of coordinated turns, without an attitude |
//! | `transition` | transition from the attitude of one stage to that of another without a step |

mod transition;
mod turn_detector;

use super::{
    aided::{self, Aided},
    estimate::Estimate,
    finite::fuser_step,
    fused::{Corrections, Fused},
    input::FuserInput,
    wz::{self, Wz},
};
use crate::{
    course::CourseReference,
    parameters::{Parameter, ParameterError, Parameters},
    scalars::{Scalars, visit_fields},
    stage::{RestoreError, Stage},
    state::Attitude,
};
use {transition::Transition, turn_detector::TurnDetector};

/// Time for which a body counts as moving over ground after ground motion was detected, s.
const GROUND_MOTION_HOLD_S: f64 = 300.0;
/// Parameters of `wz`, then those of `aided`.
///
/// A parameter that both stages have is listed once, with those of `aided`, and set in both. The
/// magnetometer parameters of `aided` are omitted because the magnetic heading is that of `wz`.
const PARAMETERS: &[Parameter] =
    &concat::<{ WZ_PARAMETERS.len() + AIDED_PARAMETERS.len() }>(WZ_PARAMETERS, AIDED_PARAMETERS);
const WZ_PARAMETERS: &[Parameter] = Wz::PARAMETERS.split_at(Wz::PARAMETERS.len() - wz::SHARED_WITH_AIDED).0;
const AIDED_PARAMETERS: &[Parameter] =
    aided::Settings::TABLE.split_at(aided::Settings::TABLE.len() - aided::MAGNETOMETER_COUNT).0;

const fn concat<const COUNT: usize>(first: &[Parameter], second: &[Parameter]) -> [Parameter; COUNT] {
    let mut all = [first[0]; COUNT];
    let mut i = 0;
    while i < COUNT {
        all[i] = if i < first.len() { first[i] } else { second[i - first.len()] };
        i += 1;
    }
    all
}

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

/// Fuser stage `multiple-model`: `wz` and `aided` in parallel, with a selection between them.
#[derive(Debug, Clone, PartialEq)]
pub struct MultipleModel {
    wz: Wz,
    aided: Aided,
    turns: TurnDetector,
    /// Time since ground motion was last detected, s.
    since_ground_motion_s: f64,
    selection: ModelSelection,
    transition: Transition,
}

impl Default for MultipleModel {
    fn default() -> Self {
        Self {
            wz: Wz::default(),
            aided: Aided::default(),
            turns: TurnDetector::default(),
            since_ground_motion_s: GROUND_MOTION_HOLD_S,
            selection: ModelSelection::WZ,
            transition: Transition::default(),
        }
    }
}

impl MultipleModel {
    pub(super) fn realign(&mut self) {
        self.wz.realign();
        self.aided.realign();
        self.turns = TurnDetector::default();
    }

    /// Selects one stage for the level and one for the heading. The choice depends on ground motion
    /// and on the references of the two headings.
    fn select(&self, wz: CourseReference, aided: CourseReference) -> ModelSelection {
        let has_ground_motion = self.since_ground_motion_s < GROUND_MOTION_HOLD_S;
        let heading = match (wz, aided) {
            (CourseReference::Magnetic, CourseReference::True) if !has_ground_motion => Model::Wz,
            (_, CourseReference::True) => Model::Aided,
            _ => Model::Wz,
        };
        ModelSelection { level: if has_ground_motion { Model::Aided } else { Model::Wz }, heading }
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let (wz, aided_corrections) = (self.wz.fuse(input), self.aided.advance(input));
        let dt_s = input.motion.as_ref().map_or(0.0, |motion| motion.dt_s);
        let has_velocity = aided_corrections.velocity && self.aided.reference == CourseReference::True;
        if self.turns.update(input, self.aided.gyro_bias_rad_s) || has_velocity {
            self.since_ground_motion_s = 0.0;
        } else {
            self.since_ground_motion_s = (self.since_ground_motion_s + dt_s).min(GROUND_MOTION_HOLD_S);
        }
        let (previous, selection) = (self.selection, self.select(wz.reference, self.aided.reference));
        self.selection = selection;
        // The output of `aided` is computed only if it is used.
        if ![previous.level, selection.level, selection.heading].contains(&Model::Aided) {
            return self.combine(&wz, &wz, None, wz.corrections.aligned, dt_s);
        }
        let aided = self.aided.output(input, aided_corrections);
        let Selected { level, heading } = selection.pick(&wz, &aided);
        let has_switched = previous.level != selection.level;
        let jumps = has_switched && self.transition.start(previous.pick(&wz, &aided).level.attitude, level.attitude);
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
}

impl Stage for MultipleModel {
    fuser_step!();

    fn name(&self) -> &'static str {
        "multiple-model"
    }

    fn parts(&self) -> &'static [&'static str] {
        &["wz", "aided"]
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        if PARAMETERS.iter().all(|parameter| parameter.name != name) {
            return Err(ParameterError::Unknown { known: PARAMETERS });
        }
        match (self.wz.set(name, value), self.aided.set(name, value)) {
            (Err(ParameterError::Unknown { .. }), aided) => aided,
            (wz, Err(ParameterError::Unknown { .. })) => wz,
            (wz, aided) => wz.and(aided),
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.wz.visit_state(visit);
        self.aided.visit_state(visit);
        visit_fields!(self, visit: turns, since_ground_motion_s, selection, transition; without wz, aided);
    }

    fn validation_error(&self) -> Option<&'static str> {
        let time = (self.since_ground_motion_s < 0.0).then_some("a negative time");
        let parts = self.wz.validation_error().or_else(|| self.aided.validation_error());
        parts.or_else(|| self.turns.validation_error()).or_else(|| self.transition.validation_error()).or(time)
    }

    fn common(&self) -> Estimate {
        let (wz, aided) = (self.wz.common(), self.aided.common());
        let Selected { level, heading } = self.selection.pick(wz, aided);
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

    /// Continues both stages from the handed-over state. A heading that refers to true north counts
    /// as ground motion.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        self.wz.adopt(common)?;
        self.aided.adopt(common)?;
        self.turns = TurnDetector::default();
        self.since_ground_motion_s = if common.reference == CourseReference::True { 0.0 } else { GROUND_MOTION_HOLD_S };
        self.selection = self.select(common.reference, common.reference);
        self.transition = Transition::default();
        Ok(())
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
