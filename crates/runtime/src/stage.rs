//! Creates the stage of a slot from the launch file.

use std::time::Duration;

use attitude::stage::Stage as _;
use host::{AnyStage, HostableStage, HostedStage};
use launch::{Launch, Slot};

use crate::RuntimeError;

/// Share of the health timeout after which an external stage counts as hung. It is less than 1, so
/// that the service can report the cause before the service itself counts as hung.
const RESPONSE_TIMEOUT_SHARE: f64 = 0.5;

/// Builds the stage that the launch file specifies, with its parameters set.
///
/// `built_in` creates a built-in stage by name. An external stage is started as a process.
///
/// # Errors
///
/// Fails if the stage does not exist or does not start, or if a parameter is rejected.
pub fn build_stage<B: HostableStage + Clone>(
    slot: Slot,
    launch: &Launch,
    built_in: impl FnOnce(&str) -> Option<B>,
) -> Result<AnyStage<B>, RuntimeError> {
    let configured = launch.stage(slot);
    let mut stage = match launch.external_stage(slot) {
        Some(program) => {
            let timeout = response_timeout(launch);
            let hosted =
                HostedStage::start(&configured.stage, program, timeout).map_err(RuntimeError::ExternalStage)?;
            AnyStage::Hosted(hosted)
        }
        None => AnyStage::BuiltIn(
            built_in(&configured.stage)
                .ok_or_else(|| RuntimeError::UnknownStage { slot, stage: configured.stage.clone() })?,
        ),
    };
    for (name, value) in &configured.set {
        stage.set(name, *value).map_err(|cause| RuntimeError::Parameter {
            slot,
            stage: configured.stage.clone(),
            name: name.clone(),
            cause,
        })?;
    }
    Ok(stage)
}

/// Returns the response timeout of an external stage.
pub fn response_timeout(launch: &Launch) -> Duration {
    Duration::from_secs_f64(launch.restart.silence_s * RESPONSE_TIMEOUT_SHARE)
}
