//! Course stage `angles`: the course is H = −ψ plus the declination, with the yaw ψ.

use super::{
    continuity::{Continuity, gyroscopic_course},
    input::CourseInput,
    reading::{CourseReading, LastReading},
};
use crate::{
    parameters::{parameters_of, settings},
    scalars::visit_fields,
    stage::{RestoreError, Stage},
};

settings! {
    /// Settings of `angles`.
    pub struct AnglesSettings {
        /// Magnetic declination, east positive. It converts a magnetic course to a true one; yaw
        /// and quaternion stay magnetic. 0 leaves the course magnetic.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
    }
}

/// Course stage `angles`: the course is minus the yaw, plus the declination.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AnglesCourse {
    settings: AnglesSettings,
    continuity: Continuity,
}

impl Stage for AnglesCourse {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "angles"
    }

    parameters_of!(AnglesSettings in settings);

    fn step(&mut self, input: &CourseInput) -> CourseReading {
        let angles = input.attitude.angles();
        let course = gyroscopic_course(input, angles.yaw_rad, self.settings.declination_deg);
        let aligned = self.continuity.has_reading && self.continuity.course.reference != course.reference;
        self.continuity.next_reading(input, angles, course, self.settings.declination_deg, aligned)
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: continuity; without settings);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.continuity.validation_error()
    }

    fn common(&self) -> LastReading {
        self.continuity.last()
    }

    fn adopt(&mut self, last: &LastReading) -> Result<(), RestoreError> {
        self.continuity = Continuity::from_last(last)?;
        Ok(())
    }
}
