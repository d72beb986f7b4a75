//! Contract of a fuser stage.

use super::{
    Estimate, Fused, FuserInput,
    multiple_model::{AidedModel, WzModel},
};
use crate::stage::{RestoreError, Stage};

/// Stage that can fill the slot `fuser`.
pub trait FuserStage: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone {
    /// Lets the next inclination re-initialise the level. Needed after a gap in which the body may
    /// have rotated arbitrarily. Heading and gyro bias are kept.
    fn realign(&mut self);

    /// Starts with sensor errors known from an earlier run: gyro bias, gyro scale and hard iron.
    ///
    /// The attitude stays unknown, whatever `prior` contains.
    ///
    /// # Errors
    ///
    /// Returns [`RestoreError`] if `prior` is invalid. The stage is then unchanged.
    fn seed_sensor_errors(&mut self, prior: &Estimate) -> Result<(), RestoreError> {
        let Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, .. } = *prior;
        self.adopt(&Estimate { bias_rad_s, bias_sd_rad_s, gyro_scale, hard_iron, ..Estimate::UNKNOWN })?;
        self.realign();
        Ok(())
    }

    /// Returns the two models of the stage `multiple-model`; `None` for any other stage.
    fn models(&mut self) -> Option<(&mut AidedModel, &mut WzModel)> {
        None
    }
}
