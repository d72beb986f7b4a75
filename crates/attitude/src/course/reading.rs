//! Output of a course stage, and the part of it that is handed over when the stage is replaced.

use core::f64::consts::TAU;

use super::reference::CourseReference;
use crate::{
    Quaternion,
    angles::Angles,
    flags::Flags,
    scalars::{are_finite, scalars},
    stage::{RestoreError, UNIT_NORM_SQUARED_TOLERANCE, Validate},
};

/// Attitude as angles, course and quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CourseReading {
    /// Yaw, pitch and roll in the fuser's frame.
    pub angles: Angles,
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// Reference direction of the course.
    pub reference: CourseReference,
    /// Standard deviation of the course, rad; π if the course is unknown.
    pub course_sd_rad: f64,
    /// Declination that was added to a magnetic heading, rad, east positive; 0 if none was added.
    pub declination_rad: f64,
    /// Quaternion from body axes to the fuser's reference frame. Its sign is continuous with that
    /// of the previous reading.
    pub quaternion: Quaternion<f64>,
    /// Set if yaw and roll cannot be separated because the nose is near the vertical.
    pub near_gimbal: bool,
    /// Set if the course was realigned, so that it jumps without a rotation of the body.
    pub aligned: bool,
}

impl CourseReading {
    /// Returns the flags of the reading.
    #[inline]
    pub fn flags(&self) -> Flags {
        Flags::NEAR_GIMBAL.when(self.near_gimbal) | Flags::ALIGNED.when(self.aligned)
    }
}

impl Validate for CourseReading {
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let Angles { yaw_rad, pitch_rad, roll_rad } = self.angles;
        let finite = are_finite([yaw_rad, pitch_rad, roll_rad, self.course_sd_rad, self.declination_rad]);
        quaternion_validation_error(self.quaternion)
            .or((!finite).then_some("a number that is not finite"))
            .or((!(0.0..TAU).contains(&self.course_rad)).then_some("a course outside [0, 2π)"))
            .or((self.course_sd_rad < 0.0).then_some("a negative standard deviation"))
    }
}

/// Course with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CourseEstimate {
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// Reference direction of the course.
    pub reference: CourseReference,
    /// Standard deviation, rad; π if the course is unknown.
    pub sd_rad: f64,
}

/// Last reading, which any course stage can hand over to any other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LastReading {
    /// Quaternion body → the fuser's reference frame.
    pub quaternion: Quaternion<f64>,
    /// Last course; `None` before the first tick.
    pub course: Option<CourseEstimate>,
}

impl LastReading {
    /// Checks the quaternion and the course.
    ///
    /// # Errors
    ///
    /// Returns [`RestoreError::Invalid`] if the quaternion is not of unit length or the course or
    /// its standard deviation is out of range.
    pub fn validate(&self) -> Result<(), RestoreError> {
        let reason = quaternion_validation_error(self.quaternion).or_else(|| {
            let CourseEstimate { course_rad, sd_rad, .. } = self.course?;
            let valid = (0.0..TAU).contains(&course_rad) && sd_rad >= 0.0;
            (!valid).then_some("a course outside [0, 2π) or a negative standard deviation")
        });
        reason.map_or(Ok(()), |flaw| Err(RestoreError::Invalid { reason: flaw }))
    }
}

scalars!(CourseReading:
    angles, course_rad, reference, course_sd_rad, declination_rad, quaternion, near_gimbal, aligned
);

scalars!(CourseEstimate: course_rad, reference, sd_rad);

scalars!(LastReading: quaternion, course);

pub(super) fn quaternion_validation_error(quaternion: Quaternion<f64>) -> Option<&'static str> {
    let unit = libm::fabs(quaternion.norm_squared() - 1.0) <= UNIT_NORM_SQUARED_TOLERANCE;
    (!unit).then_some("a quaternion that is not of unit length")
}
