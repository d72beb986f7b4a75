//! Stages of one chain, one for each of the four slots.

use attitude::{
    accel::Accelerometer,
    course::Course,
    fuser::Fuser,
    gyro::Gyro,
    parameters::{Parameter, ParameterError},
    stage::Stage,
};
use host::AnyStage;
use launch::{Launch, Service};
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
            gyro: build_stage(Service::Gyro, launch, Gyro::from_name)?,
            accel: build_stage(Service::Accel, launch, Accelerometer::from_name)?,
            fuser: build_stage(Service::Fuser, launch, Fuser::from_name)?,
            course: build_stage(Service::Course, launch, Course::from_name)?,
        })
    }

    /// Returns `true` if every timed stage runs in this process, as opposed to an external program.
    pub(crate) fn are_in_process(&self) -> bool {
        let Self { gyro, accel, fuser, course: _ } = self;
        matches!((gyro, accel, fuser), (AnyStage::BuiltIn(_), AnyStage::BuiltIn(_), AnyStage::BuiltIn(_)))
    }

    /// Sets a parameter of the stage in `slot`. Services that are not slots ignore it.
    pub(crate) fn set(&mut self, slot: Service, key: &str, value: f64) -> Result<(), ParameterError> {
        match slot {
            Service::Gyro => self.gyro.set(key, value),
            Service::Accel => self.accel.set(key, value),
            Service::Fuser => self.fuser.set(key, value),
            Service::Course => self.course.set(key, value),
            Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => Ok(()),
        }
    }

    /// Returns slot, stage name and parameters of each stage.
    pub(crate) fn parameters(&self) -> [(Service, &'static str, &'static [Parameter]); 4] {
        [
            (Service::Gyro, self.gyro.name(), self.gyro.parameters()),
            (Service::Accel, self.accel.name(), self.accel.parameters()),
            (Service::Fuser, self.fuser.name(), self.fuser.parameters()),
            (Service::Course, self.course.name(), self.course.parameters()),
        ]
    }
}
