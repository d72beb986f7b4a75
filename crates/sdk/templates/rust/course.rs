//! The stage `@name@` for the slot course: angles and course, from the fused attitude.
//!
//! Input: the attitude and what its heading is counted from. Output: yaw, pitch, roll, the course and the quaternion. Time: none.
//! Failure: near the vertical yaw and roll lose their meaning, and the output says so.

use std::f64::consts::{PI, TAU};

use attitude::{
    Quaternion,
    course::{CourseEstimate, CourseInput, CourseReading, CourseReference, LastReading},
    scalars::Scalars,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage},
};

/// Nearer to the vertical yaw and roll are not told apart, rad: 89°.
const GIMBAL_RAD: f64 = 1.553_343;

settings! {
    /// Settings of the stage.
    pub struct Settings {
        /// Magnetic declination, east positive: makes a magnetic course a true one.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
    }
}

/// The course is the fuser's heading, counted clockwise, and the declination where it is magnetic.
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
        let made_true = input.reference == CourseReference::Magnetic && self.settings.declination_deg != 0.0;
        let declination_rad = if made_true { self.settings.declination_deg.to_radians() } else { 0.0 };
        let reference = if made_true { CourseReference::True } else { input.reference };
        let course_rad = (declination_rad - angles.yaw_rad).rem_euclid(TAU) % TAU;
        let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
        let quaternion = input.attitude.quaternion();
        // The other sign is the same attitude, and a jump for whoever interpolates.
        let quaternion = if quaternion.dot(&self.last.quaternion) < 0.0 { -quaternion } else { quaternion };
        let aligned = self.last.course.is_some_and(|before| before.reference != reference);
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
        self.last.validate().err().map(|_| "an invalid last reading")
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
