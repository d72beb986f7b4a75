//! The kit tells a bad stage from a good one: each mistake fails the check that is made for it.

use attitude::{
    fuser::{Estimate, Fused, FuserInput, wz_closed::WzClosed},
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Stage},
    state::Attitude,
};

/// What is wrong with a stage that is otherwise `wz-closed`.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Mistake {
    None,
    /// Divides by the interval.
    Interval,
    /// Leaves a number out of the state.
    Forgotten,
    /// Numbers its state has whose meaning it does not check.
    Unchecked,
    /// Takes over the level and not the heading.
    HeadingLost,
    /// Takes over whatever it is given.
    Credulous,
    /// Does not follow the motion.
    Deaf,
    /// A parameter that divides by its least value.
    Parameter,
    /// Tells no number long after a stamp stood.
    Late,
}

#[derive(Debug, Clone)]
struct Bad {
    mistake: Mistake,
    inner: WzClosed,
    count: f64,
    divisor: f64,
    /// When a stamp stood.
    stood: f64,
}

const PARAMETER: &[Parameter] =
    &[Parameter { name: "divisor", unit: "", default: 1.0, min: 0.0, max: 2.0, description: "Divides." }];

impl Bad {
    fn with(mistake: Mistake) -> Self {
        Self { mistake, inner: WzClosed::default(), count: 0.0, divisor: 1.0, stood: f64::INFINITY }
    }
}

impl Stage for Bad {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz-closed"
    }

    fn parameters(&self) -> &'static [Parameter] {
        if self.mistake == Mistake::Parameter { PARAMETER } else { &[] }
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let parameter = self.parameters().iter().find(|parameter| parameter.name == name);
        let parameter = parameter.ok_or(ParameterError::Unknown { known: self.parameters() })?;
        if !(parameter.min..=parameter.max).contains(&value) {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.divisor = value;
        Ok(())
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        self.count += 1.0;
        let deaf = FuserInput { motion: None, ..*input };
        let mut fused = self.inner.step(if self.mistake == Mistake::Deaf { &deaf } else { input });
        let dt_s = input.motion.map_or(1.0, |motion| motion.dt_s);
        match self.mistake {
            Mistake::Interval => fused.innovation_rad *= dt_s * dt_s.recip(),
            Mistake::Forgotten | Mistake::Unchecked => fused.inclination_sd_rad += (self.count * 1e-3).sqrt() * 1e-6,
            Mistake::Parameter => fused.innovation_rad /= self.divisor,
            Mistake::Late if self.count > 1.0 && dt_s == 0.0 => self.stood = self.count,
            Mistake::Late if self.count > self.stood + 4000.0 => fused.innovation_rad = f64::NAN,
            _ => (),
        }
        fused
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.inner.visit_state(visit);
        if self.mistake == Mistake::Unchecked {
            visit(&mut self.count);
        }
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.inner.validation_error()
    }

    fn common(&self) -> Estimate {
        self.inner.common()
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        match self.mistake {
            Mistake::HeadingLost => {
                let attitude = Attitude { z_rad: common.attitude.z_rad + 0.1, ..common.attitude };
                self.inner.adopt(&Estimate { attitude, ..*common })
            }
            Mistake::Credulous => {
                let _ = self.inner.adopt(common);
                Ok(())
            }
            _ => self.inner.adopt(common),
        }
    }
}

fn failures(mistake: Mistake) -> Vec<String> {
    let report = conformance::fuser(|| Bad::with(mistake));
    println!("{mistake:?}: {report}");
    report.failures().map(|check| check.name.clone()).collect()
}

#[test]
fn a_good_stage_passes() {
    assert_eq!(failures(Mistake::None), Vec::<String>::new());
}

#[test]
fn each_mistake_fails_the_check_that_is_made_for_it() {
    for (mistake, check) in [
        (Mistake::Interval, "outputs are finite and rotations under stamps that stand"),
        (Mistake::Forgotten, "a run goes on from a snapshot bit for bit"),
        (Mistake::Unchecked, "a record with one impossible number is refused or does no harm"),
        (Mistake::HeadingLost, "hand-over from wz: the attitude goes on"),
        (Mistake::Credulous, "an estimate that is none is not taken over"),
        (Mistake::Deaf, "tumbling: largest inclination error with exact sensors"),
        (Mistake::Parameter, "sound and resumable with divisor = 0"),
        (Mistake::Late, "recovers from stamps that stand to "),
    ] {
        let failures = failures(mistake);
        assert!(
            failures.iter().any(|failure| failure.starts_with(check)),
            "{mistake:?}: {check} passed; failed: {failures:?}"
        );
    }
}
