//! Stage of a slot: built in or external.

use attitude::{
    fuser::{Estimate, Fuser, FuserStage},
    gyro::{Gyro, GyroStage},
    stage::{RestoreError, Snapshot, Stage, forward_stage},
    state::Attitude,
};

use crate::hosted::{HostableStage, HostedStage};

/// Built-in or external stage of a slot.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "there is one value per slot, and it is not moved")]
pub enum AnyStage<B: HostableStage> {
    /// Stage that runs in this process.
    BuiltIn(B),
    /// Stage that runs as an external program.
    Hosted(HostedStage<B>),
}

macro_rules! delegate {
    ($any:expr, $stage:ident => $call:expr) => {
        match $any {
            AnyStage::BuiltIn($stage) => $call,
            AnyStage::Hosted($stage) => $call,
        }
    };
}

impl<B: HostableStage + Clone> Stage for AnyStage<B> {
    type Input = B::Input;
    type Output = B::Output;
    type Common = B::Common;

    forward_stage!(delegate, #[inline]);

    fn failure(&self) -> Option<&dyn std::error::Error> {
        delegate!(self, stage => stage.failure())
    }

    fn visit_values(&self, visit: &mut dyn FnMut(f64)) {
        delegate!(self, stage => stage.visit_values(visit));
    }

    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError> {
        delegate!(self, stage => stage.restore(record))
    }
}

impl GyroStage for AnyStage<Gyro> {
    fn align(&mut self, attitude: Attitude) {
        delegate!(self, stage => stage.align(attitude));
    }
}

impl FuserStage for AnyStage<Fuser> {
    fn realign(&mut self) {
        delegate!(self, stage => stage.realign());
    }

    fn seed_sensor_errors(&mut self, known: &Estimate) -> Result<(), RestoreError> {
        delegate!(self, stage => stage.seed_sensor_errors(known))
    }
}
