//! The stages of one path.

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

/// The stages of one path, before their first step.
#[derive(Debug, Clone)]
pub struct Stages {
    /// Of the slot `gyro`.
    pub gyro: AnyStage<Gyro>,
    /// Of the slot `accel`.
    pub accel: AnyStage<Accelerometer>,
    /// Of the slot `fuser`.
    pub fuser: AnyStage<Fuser>,
    /// Of the slot `course`.
    pub course: AnyStage<Course>,
}

impl Stages {
    /// What a launch names, as it sets them.
    pub fn of(launch: &Launch) -> Result<Self, RuntimeError> {
        Ok(Self {
            gyro: build_stage(Service::Gyro, launch, Gyro::from_name)?,
            accel: build_stage(Service::Accel, launch, Accelerometer::from_name)?,
            fuser: build_stage(Service::Fuser, launch, Fuser::from_name)?,
            course: build_stage(Service::Course, launch, Course::from_name)?,
        })
    }

    /// None of those that are timed is a process of its own.
    pub(crate) fn are_of_this_process(&self) -> bool {
        let Self { gyro, accel, fuser, course: _ } = self;
        matches!((gyro, accel, fuser), (AnyStage::BuiltIn(_), AnyStage::BuiltIn(_), AnyStage::BuiltIn(_)))
    }

    /// Tries a setting on the stage of a slot.
    pub(crate) fn set(&mut self, slot: Service, key: &str, value: f64) -> Result<(), ParameterError> {
        match slot {
            Service::Gyro => self.gyro.set(key, value),
            Service::Accel => self.accel.set(key, value),
            Service::Fuser => self.fuser.set(key, value),
            Service::Course => self.course.set(key, value),
            Service::Ingest | Service::Gateway | Service::Drivers | Service::Cockpit => Ok(()),
        }
    }

    /// Each slot's stage and its parameters.
    pub(crate) fn parameters(&self) -> [(Service, &'static str, &'static [Parameter]); 4] {
        [
            (Service::Gyro, self.gyro.name(), self.gyro.parameters()),
            (Service::Accel, self.accel.name(), self.accel.parameters()),
            (Service::Fuser, self.fuser.name(), self.fuser.parameters()),
            (Service::Course, self.course.name(), self.course.parameters()),
        ]
    }
}
