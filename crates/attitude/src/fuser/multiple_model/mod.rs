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
//! | `aided_model` | `aided` with the detection of ground motion |
//! | `wz_model` | `wz` with the selection between the stages |
//! | `turn_detector` | detection of coordinated turns, without an attitude |
//! | `transition` | transition from the attitude of one stage to that of another without a step |

mod aided_model;
mod transition;
mod turn_detector;
mod wz_model;

pub use aided_model::{AidedModel, AidedOutput};
pub use wz_model::WzModel;

use super::{
    aided,
    estimate::Estimate,
    finite::fuser_items,
    fused::Fused,
    input::FuserInput,
    wz::{self, Wz},
};
use crate::{
    parameters::{Parameter, ParameterError, Parameters},
    stage::Stage,
};

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

/// Fuser stage `multiple-model`: `wz` and `aided` in parallel, with a selection between them.
///
/// Each model keeps its own state. At a tick, [`WzModel`] receives the output of [`AidedModel`],
/// but not the other way round. [`AidedModel`] can therefore be ahead of it, for example in another
/// thread.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MultipleModel {
    aided: AidedModel,
    wz: WzModel,
}

impl MultipleModel {
    pub(super) fn realign(&mut self) {
        self.wz.realign();
        self.aided.realign();
    }

    /// Returns the two models.
    #[inline]
    pub fn models(&mut self) -> (&mut AidedModel, &mut WzModel) {
        (&mut self.aided, &mut self.wz)
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let aided = self.aided.step(input);
        self.wz.step(input, aided.as_ref())
    }

    /// Continues both stages from the handed-over state. A heading that refers to true north counts
    /// as ground motion.
    fn continue_from(&mut self, common: &Estimate) {
        self.wz.stage.continue_from(common);
        self.aided.continue_from(common);
        self.wz.select_again(common.reference, self.aided.has_ground_motion());
    }
}

impl Stage for MultipleModel {
    fuser_items!();

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
        match (self.wz.stage.set(name, value), self.aided.stage.set(name, value)) {
            (Err(ParameterError::Unknown { .. }), aided) => aided,
            (wz, Err(ParameterError::Unknown { .. })) => wz,
            (wz, aided) => wz.and(aided),
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { aided, wz } = self;
        wz.stage.visit_state(visit);
        aided.stage.visit_state(visit);
        aided.visit_ground_motion(visit);
        wz.visit_selection(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.wz.validation_error().or_else(|| self.aided.validation_error())
    }

    fn common(&self) -> Estimate {
        self.wz.common(&self.aided.stage.common())
    }
}
