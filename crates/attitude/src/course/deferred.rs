//! Reading whose angles and course are computed on demand.
//!
//! Input: the attitude, and what the stage has determined without the angles.
//!
//! Output: the same angles and the same course, bit for bit, that the stage computes at once.
//!
//! The angles need three arctangents. A program that reads only quaternions does not need them.

use super::{
    continuity::wrap_course_rad,
    reading::{CourseReading, quaternion_validation_error},
    reference::CourseReference,
};
use crate::{Quaternion, angles::Angles, flags::Flags, scalars::are_finite, stage::Validate, state::Attitude};

/// Angles and course that are computed on demand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeferredAngles {
    attitude: Attitude,
    declination_rad: f64,
    /// Course, rad; `None` if it follows from the yaw.
    course_rad: Option<f64>,
}

impl DeferredAngles {
    pub(super) fn new(attitude: Attitude, declination_rad: f64) -> Self {
        Self { attitude, declination_rad, course_rad: None }
    }

    /// Creates the angles of an attitude whose reading is known.
    pub fn from_reading(attitude: Attitude, reading: &CourseReading) -> Self {
        let CourseReading { declination_rad, course_rad, .. } = *reading;
        Self { attitude, declination_rad, course_rad: Some(course_rad) }
    }

    /// Computes yaw, pitch and roll in the fuser's frame, and the course, rad, [0, 2π).
    pub fn compute(&self) -> (Angles, f64) {
        let angles = self.attitude.angles();
        (angles, self.course_rad.unwrap_or_else(|| wrap_course_rad(self.declination_rad - angles.yaw_rad)))
    }
}

/// Reading of a course stage with [`DeferredAngles`]. The fields are those of [`CourseReading`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeferredReading {
    /// Angles and course.
    pub angles: DeferredAngles,
    /// Reference direction of the course.
    pub reference: CourseReference,
    /// Standard deviation of the course, rad; π if the course is unknown.
    pub course_sd_rad: f64,
    /// Quaternion from body axes to the fuser's reference frame.
    pub quaternion: Quaternion<f64>,
    /// Set if yaw and roll cannot be separated because the nose is near the vertical.
    pub near_gimbal: bool,
    /// Set if the course was realigned, so that it jumps without a rotation of the body.
    pub aligned: bool,
}

impl DeferredReading {
    /// Creates the reading from a complete one. Its angles are those of `attitude`.
    pub fn from_reading(attitude: Attitude, reading: &CourseReading) -> Self {
        let CourseReading { reference, course_sd_rad, quaternion, near_gimbal, aligned, .. } = *reading;
        let angles = DeferredAngles::from_reading(attitude, reading);
        Self { angles, reference, course_sd_rad, quaternion, near_gimbal, aligned }
    }

    /// Computes the angles and the course.
    pub fn complete(&self) -> CourseReading {
        let Self { angles: deferred, reference, course_sd_rad, quaternion, near_gimbal, aligned } = *self;
        let (angles, course_rad) = deferred.compute();
        let declination_rad = deferred.declination_rad;
        CourseReading {
            angles,
            course_rad,
            reference,
            course_sd_rad,
            declination_rad,
            quaternion,
            near_gimbal,
            aligned,
        }
    }

    /// Returns the flags of the reading.
    #[inline]
    pub fn flags(&self) -> Flags {
        Flags::NEAR_GIMBAL.when(self.near_gimbal) | Flags::ALIGNED.when(self.aligned)
    }
}

impl Validate for DeferredReading {
    /// The angles are finite and the course is in its range if the attitude is finite.
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let DeferredAngles { attitude, declination_rad, course_rad } = self.angles;
        let (w, z_rad, course_rad) = (attitude.up.w, attitude.z_rad, course_rad.unwrap_or(0.0));
        let finite = are_finite([w.re, w.im, z_rad, course_rad, declination_rad, self.course_sd_rad]);
        quaternion_validation_error(self.quaternion)
            .or((!finite).then_some("a number that is not finite"))
            .or((self.course_sd_rad < 0.0).then_some("a negative standard deviation"))
    }
}
