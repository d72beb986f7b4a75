//! What fills a slot: the stage that the launch file names, with what it sets.

use attitude::stage::Stage;
use launch::Service;

use crate::RuntimeError;

/// The stage that `filling` names; `named` is the slot's own list.
pub fn filled<S: Stage>(
    slot: Service,
    filling: &launch::Stage,
    named: impl Fn(&str) -> Option<S>,
) -> Result<S, RuntimeError> {
    let name = &filling.stage;
    let mut stage = named(name).ok_or_else(|| RuntimeError::Stage { slot, stage: name.clone() })?;
    for (key, value) in &filling.settings {
        stage.set(key, *value).map_err(|cause| RuntimeError::Setting {
            slot,
            stage: name.clone(),
            key: key.clone(),
            cause,
        })?;
    }
    Ok(stage)
}
