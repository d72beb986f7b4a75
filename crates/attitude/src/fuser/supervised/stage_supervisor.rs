//! Steps of a stage with the supervision of its outputs.

use super::{
    input_supervisor::{Realignment, SupervisedInput},
    output_flags::{OutputSupervisor, SupervisedFused},
};
use crate::{
    fuser::{
        FuserStage, innovation_rad,
        multiple_model::{AidedModel, AidedOutput, WzModel},
    },
    stage::Validate as _,
    validated_stage::ValidatedStage,
};

/// Minimum tilt error that causes a realignment after an outage, rad (5°). Noise and vehicle
/// manoeuvres stay below it.
const REALIGN_TILT_RAD: f64 = 0.087;

/// Stage with the supervision of its outputs.
#[derive(Debug)]
pub struct StageSupervisor<'a, S> {
    pub(super) validated: &'a mut ValidatedStage<S>,
    pub(super) outputs: OutputSupervisor<'a>,
}

impl<S: FuserStage> StageSupervisor<'_, S> {
    /// Returns the models of the stage `multiple-model`, which can run in different threads.
    ///
    /// Returns `None` for any other stage, and once the stage has failed permanently.
    pub fn models(&mut self) -> Option<(AidedPart<'_>, WzPart<'_>)> {
        if self.validated.has_failed() {
            return None;
        }
        let OutputSupervisor { is_aligned, reset_counter, attitude } = &mut self.outputs;
        let outputs = OutputSupervisor { is_aligned, reset_counter, attitude };
        let (aided, model) = self.validated.stage.models()?;
        Some((AidedPart(aided), WzPart { model, outputs }))
    }

    /// Resets the stage after an invalid output and steps it again. Returns `None` if the stage has
    /// failed permanently.
    #[cold]
    pub fn reset_and_step(&mut self, input: &SupervisedInput) -> Option<SupervisedFused> {
        let fused = self.validated.reset_and_step(&input.input)?;
        Some(self.outputs.supervise(fused, true, input.is_sensor_stage_reset))
    }

    /// Steps the stage. Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(&mut self, input: &SupervisedInput) -> Option<SupervisedFused> {
        if self.needs_realignment(input) {
            self.validated.stage.realign();
        }
        let (fused, is_reset) = self.validated.step(&input.input)?;
        Some(self.outputs.supervise(fused, is_reset, input.is_sensor_stage_reset))
    }

    #[inline(always)]
    fn needs_realignment(&self, input: &SupervisedInput) -> bool {
        match input.realignment {
            Realignment::No => false,
            Realignment::Yes => true,
            Realignment::IfTilted => input
                .input
                .inclination
                .is_some_and(|inclination| innovation_rad(&inclination, *self.outputs.attitude) > REALIGN_TILT_RAD),
        }
    }
}

/// Model `aided` of a supervised stage `multiple-model`.
#[derive(Debug)]
pub struct AidedPart<'a>(&'a mut AidedModel);

impl AidedPart<'_> {
    /// Processes a tick. Returns `None` if [`WzPart`] does not need the output.
    ///
    /// The input must be [sanitized](crate::fuser::FuserInput::sanitize) and
    /// [independent](SupervisedInput::is_independent).
    #[inline]
    pub fn step(&mut self, input: &SupervisedInput) -> Option<AidedOutput> {
        if input.realignment == Realignment::Yes {
            self.0.realign();
        }
        self.0.step(&input.input)
    }

    /// Replaces the state by that of the model in a copy of the stage.
    pub fn copy_from(&mut self, copy: &AidedPart<'_>) {
        self.0.clone_from(copy.0);
    }
}

/// Model `wz` of a supervised stage `multiple-model`, with the supervision of the outputs.
#[derive(Debug)]
pub struct WzPart<'a> {
    model: &'a mut WzModel,
    outputs: OutputSupervisor<'a>,
}

impl WzPart<'_> {
    /// Processes a tick for which `aided` has been computed by [`AidedPart`].
    ///
    /// Returns `None` if the output is invalid. The tick must then be repeated with
    /// [`StageSupervisor::reset_and_step`].
    #[inline]
    pub fn step(&mut self, input: &SupervisedInput, aided: Option<&AidedOutput>) -> Option<SupervisedFused> {
        if input.realignment == Realignment::Yes {
            self.model.realign();
        }
        let fused = self.model.step(&input.input, aided);
        let is_valid = fused.validation_error().is_none();
        is_valid.then(|| self.outputs.supervise(fused, false, input.is_sensor_stage_reset))
    }
}
