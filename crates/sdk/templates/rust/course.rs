//! Stage `@name@` for the slot course: angles and course, from the fused attitude.
//!
//! Input: the attitude and the reference direction of its heading.
//!
//! Output: yaw, pitch, roll, course and quaternion.
//!
//! Failure: near the vertical, yaw and roll are ill-defined, and the output is flagged.

use std::f64::consts::{PI, TAU};

use attitude::{
    Quaternion,
    course::{CourseEstimate, CourseInput, CourseReading, CourseReference, LastReading},
    parameters::{Parameter, ParameterError, Parameters, settings},
    scalars::Scalars,
    stage::{RestoreError, Stage},
};

/// Pitch beyond which yaw and roll cannot be separated, rad (89°).
const GIMBAL_RAD: f64 = 1.553_343;

settings! {
    /// Settings of the stage.
    pub struct Settings {
        /// Magnetic declination, east positive. It converts a magnetic course to a true one.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
    }
}

/// Stage that reports the fuser's heading as a clockwise course.
///
/// The declination is added if the heading is magnetic.
#[derive(Debug, Clone)]
pub struct @Class@ {
    settings: Settings,
    last: LastReading,
}

impl Default for @Class@ {
    fn default() -> Self {
        let last = LastReading { quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0), course: None };
        Self { settings: Settings::default(), last }
    }
}

impl Stage for @Class@ {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "@name@"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &CourseInput) -> CourseReading {
        let angles = input.attitude.angles();
        let is_corrected = input.reference == CourseReference::Magnetic && self.settings.declination_deg != 0.0;
        let declination_rad = if is_corrected { self.settings.declination_deg.to_radians() } else { 0.0 };
        let reference = if is_corrected { CourseReference::True } else { input.reference };
        let course_rad = (declination_rad - angles.yaw_rad).rem_euclid(TAU) % TAU;
        let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
        let quaternion = input.attitude.quaternion();
        // The quaternion keeps its sign, because a change of sign would break interpolation.
        let quaternion = if quaternion.dot(&self.last.quaternion) < 0.0 { -quaternion } else { quaternion };
        let aligned = self.last.course.is_some_and(|previous| previous.reference != reference);
        self.last = LastReading { quaternion, course: Some(CourseEstimate { course_rad, reference, sd_rad }) };
        CourseReading {
            angles,
            course_rad,
            reference,
            course_sd_rad: sd_rad,
            declination_rad,
            quaternion,
            near_gimbal: angles.pitch_rad.abs() > GIMBAL_RAD,
            aligned,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.last.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.last.validate().err().map(|_| "an invalid previous reading")
    }

    fn common(&self) -> LastReading {
        self.last
    }

    fn adopt(&mut self, common: &LastReading) -> Result<(), RestoreError> {
        common.validate()?;
        self.last = *common;
        Ok(())
    }
}
