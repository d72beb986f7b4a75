//! From a launch file's words to a stage that fills a slot.

use attitude::stage::Stage;
use launch::Service;

use crate::RuntimeError;

/// The stage that fills a slot, set as the launch file says.
pub fn filled<S: Stage>(
    slot: Service,
    chosen: &launch::Stage,
    named: impl FnOnce(&str) -> Option<S>,
) -> Result<S, RuntimeError> {
    let mut stage = named(&chosen.stage).ok_or(RuntimeError::Stage { slot, stage: chosen.stage.clone() })?;
    for (name, value) in &chosen.set {
        stage.set(name, *value).map_err(|cause| RuntimeError::Parameter {
            slot,
            stage: chosen.stage.clone(),
            name: name.clone(),
            cause,
        })?;
    }
    Ok(stage)
}
