//! The course stage `angles`: H = −ψ, and the declination.

use super::{
    continuity::{Continuity, gyroscopic},
    input::CourseInput,
    reading::{LastReading, Reading},
};
use crate::{
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage},
};

settings! {
    /// Settings of `angles`.
    pub struct AnglesSettings {
        /// Magnetic declination, east positive: with it a magnetic course becomes a true one; yaw and quaternion stay magnetic. 0 leaves the course magnetic.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
    }
}

/// The course stage `angles`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OfAngles {
    settings: AnglesSettings,
    continuity: Continuity,
}

impl Stage for OfAngles {
    type Input = CourseInput;
    type Output = Reading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "angles"
    }

    fn parameters(&self) -> &'static [Parameter] {
        AnglesSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &CourseInput) -> Reading {
        let angles = input.attitude.angles();
        let bearing = gyroscopic(input, angles.yaw_rad, self.settings.declination_deg);
        let aligned = self.continuity.told && self.continuity.bearing.reference != bearing.reference;
        self.continuity.read(input, angles, bearing, self.settings.declination_deg, aligned)
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.continuity.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        self.continuity.flaw()
    }

    fn common(&self) -> LastReading {
        self.continuity.last()
    }

    fn adopt(&mut self, last: &LastReading) -> Result<(), RestoreError> {
        self.continuity = Continuity::of(last)?;
        Ok(())
    }
}
