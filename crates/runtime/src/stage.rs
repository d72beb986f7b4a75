//! What fills a slot: from a launch file's words to a stage, and one that gives no output begun anew.

use std::time::Duration;

use attitude::stage::{Snapshot, Sound, Stage};
use host::{AnyStage, Hosted, HostedBy};
use launch::{Launch, Service};

use crate::RuntimeError;

/// Of the silence for which a service is killed, the part that its program may be silent: the service is to say why.
const SILENCE_SHARE: f64 = 0.5;

/// The stage that fills a slot, set as the launch file says: one of Plumbline's own, which `named` makes, or a program.
pub fn chosen<B: HostedBy + Clone>(
    slot: Service,
    launch: &Launch,
    named: impl FnOnce(&str) -> Option<B>,
) -> Result<AnyStage<B>, RuntimeError> {
    let Some(chosen) = launch.slot(slot) else {
        return Err(RuntimeError::Stage { slot, stage: String::new() });
    };
    let mut stage = match launch.program(slot) {
        Some(program) => {
            AnyStage::Hosted(Hosted::start(&chosen.stage, program, limit(launch)).map_err(RuntimeError::Program)?)
        }
        None => AnyStage::BuiltIn(
            named(&chosen.stage).ok_or_else(|| RuntimeError::Stage { slot, stage: chosen.stage.clone() })?,
        ),
    };
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

/// How long a program may take for an answer.
pub fn limit(launch: &Launch) -> Duration {
    Duration::from_secs_f64(launch.restart.silence_s * SILENCE_SHARE)
}

/// A stage in its slot. One whose output is none begins anew, once; a tick for which there is no output even then is its last.
#[derive(Debug)]
pub struct Filled<S> {
    /// The stage.
    pub stage: S,
    /// Its state before the first step.
    fresh: Snapshot,
    /// What is wrong with its last output.
    flaw: Option<&'static str>,
}

impl<S: Stage<Output: Sound> + Clone> Filled<S> {
    /// A slot is filled with a stage that has not stepped yet.
    pub fn new(stage: S) -> Self {
        Self { fresh: stage.snapshot(), stage, flaw: None }
    }

    /// One tick: the output, and whether the stage has begun anew for it. `None` for ever where the stage cannot go on.
    #[inline]
    pub fn step(&mut self, input: &S::Input) -> Option<(S::Output, bool)> {
        if self.flaw.is_some() {
            return None;
        }
        let output = self.stage.step(input);
        if output.flaw().is_none() { Some((output, false)) } else { self.begin_anew(input) }
    }

    #[cold]
    fn begin_anew(&mut self, input: &S::Input) -> Option<(S::Output, bool)> {
        let begun = self.stage.restore(&self.fresh);
        let output = self.stage.step(input);
        self.flaw = begun.err().map(|_| "it does not begin anew").or(output.flaw());
        self.flaw.is_none().then_some((output, true))
    }

    /// Why nothing more comes of it.
    pub fn failure(&self) -> Option<String> {
        match (self.stage.failure(), self.flaw) {
            (Some(error), _) => Some(error.to_string()),
            (None, flaw) => flaw.map(|flaw| format!("`{}` gives {flaw}, also when it begins anew", self.stage.name())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use attitude::{Vector3, accel::Inclination, point::Point, stage::RestoreError};

    /// Counts its steps, and gives what is none on the steps named.
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
    fn a_stage_whose_output_is_none_begins_anew_and_that_is_told() {
        let mut filled = Filled::new(Counter { steps: 0.0, bad_from: 3.0 });
        let told: Vec<_> =
            (0..5).map(|_| filled.step(&Vector3::zeros()).map(|(out, anew)| (out.norm_m_s2, anew))).collect();
        let expected = [(1.0, false), (2.0, false), (1.0, true), (2.0, false), (1.0, true)];
        assert_eq!(told, expected.map(Some));
        assert_eq!(filled.failure(), None);
    }

    #[test]
    fn a_stage_that_never_gives_an_output_ends_with_the_reason() {
        let mut filled = Filled::new(Counter { steps: 0.0, bad_from: 1.0 });
        assert!((0..3).all(|_| filled.step(&Vector3::zeros()).is_none()));
        let why = filled.failure().unwrap();
        assert_eq!(why, "`counter` gives a number that is not finite, also when it begins anew");
    }
}
