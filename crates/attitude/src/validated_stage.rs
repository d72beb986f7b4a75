//! Validation of the outputs of a stage, which is reset after an invalid one.
//!
//! Input: the input of the stage.
//!
//! Output: a valid output of the stage.
//!
//! Failure: an invalid output causes a reset of the stage. If the output after the reset is also
//! invalid, the stage has failed permanently.

use core::fmt;

use crate::stage::{Snapshot, Stage, Validate};

/// Stage with validated outputs. It is reset to its initial state if it returns an invalid one.
#[derive(Debug, Clone)]
pub struct ValidatedStage<S> {
    /// The wrapped stage.
    pub stage: S,
    /// State before the first step.
    initial: Snapshot,
    /// Problem with the output after a reset.
    output_error: Option<&'static str>,
}

impl<S: Stage<Output: Validate> + Clone> ValidatedStage<S> {
    /// Wraps a stage that has not been stepped yet.
    pub fn new(stage: S) -> Self {
        Self { initial: stage.snapshot(), stage, output_error: None }
    }

    /// Steps the stage. Returns the output, and `true` if the stage was reset in this step.
    ///
    /// Returns `None` once the stage has failed permanently.
    #[inline(always)]
    pub fn step(&mut self, input: &S::Input) -> Option<(S::Output, bool)> {
        if self.output_error.is_some() {
            return None;
        }
        let mut output = self.stage.step(input);
        let is_reset = output.validation_error().is_some();
        if is_reset {
            output = self.reset_and_step(input)?;
        }
        Some((output, is_reset))
    }

    /// Resets the stage and steps it. Returns `None` if the output is still invalid: the stage has
    /// then failed permanently.
    #[cold]
    pub(crate) fn reset_and_step(&mut self, input: &S::Input) -> Option<S::Output> {
        let restored = self.stage.restore(&self.initial);
        let output = self.stage.step(input);
        self.output_error = restored.err().map(|_| "an error").or(output.validation_error());
        self.output_error.is_none().then_some(output)
    }

    /// Returns `true` if the output was invalid even after a reset.
    #[inline]
    pub(crate) fn has_failed(&self) -> bool {
        self.output_error.is_some()
    }

    /// Returns the cause if the stage has failed permanently, else `None`.
    pub fn failure(&self) -> Option<StageFailure<'_>> {
        match (self.stage.failure(), self.output_error) {
            (Some(error), _) => Some(StageFailure::Stage(error)),
            (None, reason) => reason.map(|reason| StageFailure::InvalidOutput { stage: self.stage.name(), reason }),
        }
    }
}

/// Permanent failure of a stage.
#[derive(Debug)]
pub enum StageFailure<'a> {
    /// The stage has reported an error. Only stages in a separate process report errors.
    Stage(&'a dyn core::error::Error),
    /// The output is invalid even after a reset.
    InvalidOutput {
        /// Name of the stage.
        stage: &'static str,
        /// Validation error of the output.
        reason: &'static str,
    },
}

impl fmt::Display for StageFailure<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stage(error) => error.fmt(f),
            Self::InvalidOutput { stage, reason } => write!(f, "`{stage}` returned {reason}, also after a reset"),
        }
    }
}

impl core::error::Error for StageFailure<'_> {}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString;

    use super::*;
    use crate::{Vector3, accel::Inclination, point::Point, stage::RestoreError};

    /// Stage that counts its steps and returns an invalid output from step `bad_from` onwards.
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
        let mut validated = ValidatedStage::new(Counter { steps: 0.0, bad_from: 3.0 });
        let expected = [(1.0, false), (2.0, false), (1.0, true), (2.0, false), (1.0, true)];
        for expected in expected {
            let (output, is_reset) = validated.step(&Vector3::zeros()).unwrap();
            assert_eq!((output.norm_m_s2, is_reset), expected);
        }
        assert!(validated.failure().is_none());
    }

    #[test]
    fn stage_with_only_invalid_outputs_fails_with_cause() {
        let mut validated = ValidatedStage::new(Counter { steps: 0.0, bad_from: 1.0 });
        assert!((0..3).all(|_| validated.step(&Vector3::zeros()).is_none()));
        let cause = validated.failure().unwrap().to_string();
        assert!(cause.starts_with("`counter` returned ") && cause.ends_with("also after a reset"), "{cause}");
    }
}
