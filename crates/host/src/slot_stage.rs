//! What fills a slot: a stage of Plumbline's own, or one that is a program.

use attitude::{
    fuser::{Estimate, Fuser, FuserStage},
    gyro::{Gyro, GyroStage},
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Snapshot, Stage},
    state::Attitude,
};

use crate::hosted::{Hosted, HostedBy};

/// A stage of Plumbline's own, or a program in its place.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "one value per slot; what is computed stays where it is")]
pub enum AnyStage<B: HostedBy> {
    /// In this process.
    BuiltIn(B),
    /// In a process of its own.
    Hosted(Hosted<B>),
}

macro_rules! each {
    ($any:expr, $stage:ident => $do:expr) => {
        match $any {
            AnyStage::BuiltIn($stage) => $do,
            AnyStage::Hosted($stage) => $do,
        }
    };
}

impl<B: HostedBy + Clone> Stage for AnyStage<B> {
    type Input = B::Input;
    type Output = B::Output;
    type Common = B::Common;

    fn name(&self) -> &'static str {
        each!(self, stage => stage.name())
    }

    fn parts(&self) -> &'static [&'static str] {
        each!(self, stage => stage.parts())
    }

    fn parameters(&self) -> &'static [Parameter] {
        each!(self, stage => stage.parameters())
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        each!(self, stage => stage.set(name, value))
    }

    #[inline]
    fn step(&mut self, input: &B::Input) -> B::Output {
        each!(self, stage => stage.step(input))
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        each!(self, stage => stage.visit_state(visit));
    }

    fn flaw(&self) -> Option<&'static str> {
        each!(self, stage => stage.flaw())
    }

    fn common(&self) -> B::Common {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, common: &B::Common) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(common))
    }

    fn failure(&self) -> Option<&dyn std::error::Error> {
        each!(self, stage => stage.failure())
    }

    fn snapshot(&self) -> Snapshot {
        each!(self, stage => stage.snapshot())
    }

    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError> {
        each!(self, stage => stage.restore(record))
    }
}

impl GyroStage for AnyStage<Gyro> {
    fn align(&mut self, attitude: Attitude) {
        each!(self, stage => stage.align(attitude));
    }
}

impl FuserStage for AnyStage<Fuser> {
    fn realign(&mut self) {
        each!(self, stage => stage.realign());
    }

    fn begin_with(&mut self, known: &Estimate) -> Result<(), RestoreError> {
        each!(self, stage => stage.begin_with(known))
    }
}
