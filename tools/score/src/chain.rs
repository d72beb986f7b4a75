//! Stages of one chain, one for each of the four slots.

use attitude::{
    accel::Accelerometer,
    course::Course,
    fuser::Fuser,
    gyro::Gyro,
    parameters::{Parameter, ParameterError},
    stage::Stage,
};
use host::{AnyStage, HostableStage};
use launch::{Launch, Slot};
use runtime::{RuntimeError, stage::build_stage};

/// The stages of one chain, before their first step.
#[derive(Debug, Clone)]
pub struct StageChain {
    /// Stage of the slot `gyro`.
    pub gyro: AnyStage<Gyro>,
    /// Stage of the slot `accel`.
    pub accel: AnyStage<Accelerometer>,
    /// Stage of the slot `fuser`.
    pub fuser: AnyStage<Fuser>,
    /// Stage of the slot `course`.
    pub course: AnyStage<Course>,
}

impl StageChain {
    /// Builds the stages that a launch file selects, with their settings.
    ///
    /// # Errors
    ///
    /// Returns an error if a stage is unknown, rejects a setting or cannot be started.
    pub fn from_launch(launch: &Launch) -> Result<Self, RuntimeError> {
        Ok(Self {
            gyro: build_stage(Slot::Gyro, launch, Gyro::from_name)?,
            accel: build_stage(Slot::Accel, launch, Accelerometer::from_name)?,
            fuser: build_stage(Slot::Fuser, launch, Fuser::from_name)?,
            course: build_stage(Slot::Course, launch, Course::from_name)?,
        })
    }

    /// Returns `true` if the gyro, accel and fuser stages, which are timed, run in this process.
    pub(crate) fn are_in_process(&self) -> bool {
        let Self { gyro, accel, fuser, course: _ } = self;
        matches!((gyro, accel, fuser), (AnyStage::BuiltIn(_), AnyStage::BuiltIn(_), AnyStage::BuiltIn(_)))
    }

    /// Returns the CPU time in ns that the external programs of the timed stages have used so far;
    /// `None` if unknown.
    pub(crate) fn program_cpu_ns(&self) -> Option<f64> {
        let Self { gyro, accel, fuser, course: _ } = self;
        Some(program_cpu_ns(gyro)? + program_cpu_ns(accel)? + program_cpu_ns(fuser)?)
    }

    /// Sets a parameter of the stage in `slot`.
    pub(crate) fn set(&mut self, slot: Slot, key: &str, value: f64) -> Result<(), ParameterError> {
        match slot {
            Slot::Gyro => self.gyro.set(key, value),
            Slot::Accel => self.accel.set(key, value),
            Slot::Fuser => self.fuser.set(key, value),
            Slot::Course => self.course.set(key, value),
        }
    }

    /// Returns slot, stage name and parameters of each stage.
    pub(crate) fn parameters(&self) -> [(Slot, &'static str, &'static [Parameter]); 4] {
        [
            (Slot::Gyro, self.gyro.name(), self.gyro.parameters()),
            (Slot::Accel, self.accel.name(), self.accel.parameters()),
            (Slot::Fuser, self.fuser.name(), self.fuser.parameters()),
            (Slot::Course, self.course.name(), self.course.parameters()),
        ]
    }
}

/// Returns the CPU time in ns that the external program of a stage has used so far; 0 for a
/// built-in stage.
fn program_cpu_ns<B: HostableStage>(stage: &AnyStage<B>) -> Option<f64> {
    match stage {
        AnyStage::BuiltIn(_) => Some(0.0),
        AnyStage::Hosted(program) => program.cpu_ns(),
    }
}
