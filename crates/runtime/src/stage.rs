//! Creation of the stage of a slot from the launch file, and its reset after an invalid output.

use std::time::Duration;

use attitude::stage::{Snapshot, Stage, Validate};
use host::{AnyStage, HostableStage, HostedStage};
use launch::{Launch, Slot};

use crate::RuntimeError;

/// Share of the health timeout after which an external stage counts as hung. It is less than 1, so
/// that the service can still report the cause before its own timeout.
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

/// Stage that is reset once if it returns an invalid output. If the output after the reset is also
/// invalid, the stage has failed permanently.
#[derive(Debug)]
pub struct ResettingStage<S> {
    /// The wrapped stage.
    pub stage: S,
    /// State before the first step.
    initial: Snapshot,
    /// Problem with the output after a reset.
    output_error: Option<&'static str>,
}

impl<S: Stage<Output: Validate> + Clone> ResettingStage<S> {
    /// Wraps a stage that has not been stepped yet.
    pub fn new(stage: S) -> Self {
        Self { initial: stage.snapshot(), stage, output_error: None }
    }

    /// Steps the stage. Returns the output, and `true` if the stage was reset for it.
    ///
    /// Returns `None` once the stage has failed permanently.
    #[inline]
    pub fn step(&mut self, input: &S::Input) -> Option<(S::Output, bool)> {
        if self.output_error.is_some() {
            return None;
        }
        let output = self.stage.step(input);
        if output.validation_error().is_none() { Some((output, false)) } else { self.reset_and_step(input) }
    }

    #[cold]
    fn reset_and_step(&mut self, input: &S::Input) -> Option<(S::Output, bool)> {
        let restored = self.stage.restore(&self.initial);
        let output = self.stage.step(input);
        self.output_error = restored.err().map(|_| "an error").or(output.validation_error());
        self.output_error.is_none().then_some((output, true))
    }

    /// Returns the cause if the stage has failed permanently, else `None`.
    pub fn failure(&self) -> Option<String> {
        match (self.stage.failure(), self.output_error) {
            (Some(error), _) => Some(error.to_string()),
            (None, fault) => fault.map(|fault| format!("`{}` returned {fault}, also after a reset", self.stage.name())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::{Vector3, accel::Inclination, point::Point, stage::RestoreError};

    /// Stage that counts its steps and returns an invalid output from step `bad_from` on.
    #[derive(Clone)]
    struct Counter {
        steps: f64,
        bad_from: f64,
    }

    impl Stage for Counter {
        type Input = Vector3<f64>;
        type Output = Inclination;
        type Common = Point;

        fn name(&self) -> &'static str {
            "counter"
        }

        fn step(&mut self, _: &Vector3<f64>) -> Inclination {
            self.steps += 1.0;
            let good = self.steps < self.bad_from;
            Inclination { norm_m_s2: if good { self.steps } else { f64::NAN }, ..Inclination::default() }
        }

        fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
            visit(&mut self.steps);
        }

        fn common(&self) -> Point {
            Point::default()
        }

        fn adopt(&mut self, _: &Point) -> Result<(), RestoreError> {
            Ok(())
        }
    }

    #[test]
    fn stage_with_invalid_output_is_reset_and_flagged() {
        let mut resetting = ResettingStage::new(Counter { steps: 0.0, bad_from: 3.0 });
        let outputs: Vec<_> = (0..5)
            .map(|_| resetting.step(&Vector3::zeros()).map(|(out, is_reset)| (out.norm_m_s2, is_reset)))
            .collect();
        let expected = [(1.0, false), (2.0, false), (1.0, true), (2.0, false), (1.0, true)];
        assert_eq!(outputs, expected.map(Some));
        assert_eq!(resetting.failure(), None);
    }

    #[test]
    fn stage_with_only_invalid_outputs_fails_with_cause() {
        let mut resetting = ResettingStage::new(Counter { steps: 0.0, bad_from: 1.0 });
        assert!((0..3).all(|_| resetting.step(&Vector3::zeros()).is_none()));
        let cause = resetting.failure().unwrap();
        assert!(cause.starts_with("`counter` returned ") && cause.ends_with("also after a reset"), "{cause}");
    }
}
