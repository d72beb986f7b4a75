//! Course stage `angles`: the course is H = −ψ plus the declination, with the yaw ψ.

use super::{
    continuity::{Continuity, corrected_reference, gyroscopic_course, has_near_gimbal_angles, heading_sd_rad},
    deferred::{DeferredAngles, DeferredReading},
    input::CourseInput,
    reading::{CourseEstimate, CourseReading, LastReading},
    reference::CourseReference,
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

impl AnglesCourse {
    /// Processes a tick like [`step`](Stage::step), but without the angles and the course.
    ///
    /// The state lacks the course of the reading until [`store_course`](Self::store_course).
    #[inline(always)]
    pub(super) fn step_deferred(&mut self, input: &CourseInput) -> DeferredReading {
        let (declination_rad, reference) = corrected_reference(input, self.settings.declination_deg);
        let aligned = self.is_realigned(reference);
        let quaternion = self.continuity.next_quaternion(input.attitude);
        let course_sd_rad = heading_sd_rad(input);
        let course = CourseEstimate { reference, sd_rad: course_sd_rad, ..self.continuity.course };
        self.continuity = Continuity { quaternion, course, has_reading: true };
        let angles = DeferredAngles::from_yaw(input.attitude, declination_rad);
        let near_gimbal = has_near_gimbal_angles(input.attitude);
        DeferredReading { angles, reference, course_sd_rad, declination_rad, quaternion, near_gimbal, aligned }
    }

    /// Stores the course of the newest reading.
    pub(super) fn store_course(&mut self, course_rad: f64) {
        self.continuity.course.course_rad = course_rad;
    }

    fn is_realigned(&self, reference: CourseReference) -> bool {
        self.continuity.has_reading && self.continuity.course.reference != reference
    }
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
        let aligned = self.is_realigned(course.reference);
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
