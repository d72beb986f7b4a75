//! Tests that a stage with a defect fails the corresponding check, and that one without defects
//! passes.

use attitude::{
    fuser::{Estimate, Fused, FuserInput, wz_closed::WzClosed},
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Stage},
    state::Attitude,
};

/// Defect of a stage that otherwise behaves as `wz-closed`.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Defect {
    None,
    /// An output number is divided by the interval.
    Interval,
    /// A number is missing from the visited state.
    MissingState,
    /// The state contains a number that is not validated.
    UncheckedState,
    /// `adopt` takes over the level but not the heading.
    WrongHeading,
    /// `adopt` accepts any state.
    AcceptsAnyState,
    /// The motion is ignored.
    IgnoresMotion,
    /// An output number is divided by a parameter with a minimum of 0.
    Parameter,
    /// An output number becomes NaN long after an interval of zero.
    DelayedNan,
}

#[derive(Debug, Clone)]
struct DefectiveStage {
    defect: Defect,
    inner: WzClosed,
    count: f64,
    divisor: f64,
    /// Index of the last step with an interval of zero; infinite until such a step has occurred.
    zero_interval_step: f64,
}

const PARAMETER: &[Parameter] =
    &[Parameter { name: "divisor", unit: "", default: 1.0, min: 0.0, max: 2.0, description: "Divisor." }];

impl DefectiveStage {
    fn new(defect: Defect) -> Self {
        Self { defect, inner: WzClosed::default(), count: 0.0, divisor: 1.0, zero_interval_step: f64::INFINITY }
    }
}

impl Stage for DefectiveStage {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "wz-closed"
    }

    fn parameters(&self) -> &'static [Parameter] {
        if self.defect == Defect::Parameter { PARAMETER } else { &[] }
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
        let without_motion = FuserInput { motion: None, ..*input };
        let mut fused = self.inner.step(if self.defect == Defect::IgnoresMotion { &without_motion } else { input });
        let dt_s = input.motion.map_or(1.0, |motion| motion.dt_s);
        match self.defect {
            Defect::Interval => fused.innovation_rad *= dt_s * dt_s.recip(),
            Defect::MissingState | Defect::UncheckedState => {
                fused.inclination_sd_rad += (self.count * 1e-3).sqrt() * 1e-6
            }
            Defect::Parameter => fused.innovation_rad /= self.divisor,
            Defect::DelayedNan if self.count > 1.0 && dt_s == 0.0 => self.zero_interval_step = self.count,
            Defect::DelayedNan if self.count > self.zero_interval_step + 4000.0 => fused.innovation_rad = f64::NAN,
            _ => (),
        }
        fused
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.inner.visit_state(visit);
        if self.defect == Defect::UncheckedState {
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
        match self.defect {
            Defect::WrongHeading => {
                let attitude = Attitude { z_rad: common.attitude.z_rad + 0.1, ..common.attitude };
                self.inner.adopt(&Estimate { attitude, ..*common })
            }
            Defect::AcceptsAnyState => {
                let _ = self.inner.adopt(common);
                Ok(())
            }
            _ => self.inner.adopt(common),
        }
    }
}

fn failures(defect: Defect) -> Vec<String> {
    let report = conformance::fuser(|| DefectiveStage::new(defect));
    println!("{defect:?}: {report}");
    report.failures().map(|check| check.name.clone()).collect()
}

#[test]
fn stage_without_defect_passes() {
    assert_eq!(failures(Defect::None), Vec::<String>::new());
}

#[test]
fn each_defect_fails_its_check() {
    for (defect, check) in [
        (Defect::Interval, "outputs are valid under constant timestamps"),
        (Defect::MissingState, "a restored run is bit-identical"),
        (Defect::UncheckedState, "a snapshot with one altered value is rejected or harmless"),
        (Defect::WrongHeading, "hand-over from wz: the attitude is continuous"),
        (Defect::AcceptsAnyState, "an invalid common state is rejected"),
        (Defect::IgnoresMotion, "tumbling: largest inclination error with exact sensors"),
        (Defect::Parameter, "valid and repeatable with divisor = 0"),
        (Defect::DelayedNan, "recovers from constant timestamps to within "),
    ] {
        let failures = failures(defect);
        assert!(
            failures.iter().any(|failure| failure.starts_with(check)),
            "{defect:?}: {check} passed; failed: {failures:?}"
        );
    }
}
