//! Reading of a course stage, with angles and course that are computed on demand.
//!
//! Input: the attitude, and the results of the stage that do not need the angles.
//!
//! Output: the bits of the angles and the course that the complete step computes.
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
    course: DeferredCourse,
}

/// Source of the course.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DeferredCourse {
    /// The course is the declination (rad) minus the yaw.
    Yaw { declination_rad: f64 },
    /// The stage has determined the course, rad.
    Known { course_rad: f64 },
}

impl DeferredAngles {
    pub(super) fn from_yaw(attitude: Attitude, declination_rad: f64) -> Self {
        Self { attitude, course: DeferredCourse::Yaw { declination_rad } }
    }

    /// Computes yaw, pitch and roll in the fuser's frame, and the course, rad, [0, 2π).
    pub fn compute(&self) -> (Angles, f64) {
        let angles = self.attitude.angles();
        let course_rad = match self.course {
            DeferredCourse::Yaw { declination_rad } => wrap_course_rad(declination_rad - angles.yaw_rad),
            DeferredCourse::Known { course_rad } => course_rad,
        };
        (angles, course_rad)
    }

    /// A finite attitude has finite angles.
    #[inline]
    fn is_finite(&self) -> bool {
        let (w, z_rad) = (self.attitude.up.w, self.attitude.z_rad);
        let (DeferredCourse::Yaw { declination_rad: course_rad } | DeferredCourse::Known { course_rad }) = self.course;
        are_finite([w.re, w.im, z_rad, course_rad])
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
    /// Declination that was added to a magnetic heading, rad, east positive; 0 if none was added.
    pub declination_rad: f64,
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
        let CourseReading {
            reference,
            course_rad,
            course_sd_rad,
            declination_rad,
            quaternion,
            near_gimbal,
            aligned,
            ..
        } = *reading;
        let angles = DeferredAngles { attitude, course: DeferredCourse::Known { course_rad } };
        Self { angles, reference, course_sd_rad, declination_rad, quaternion, near_gimbal, aligned }
    }

    /// Computes the angles and the course.
    pub fn complete(&self) -> CourseReading {
        let Self { angles, reference, course_sd_rad, declination_rad, quaternion, near_gimbal, aligned } = *self;
        let (angles, course_rad) = angles.compute();
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
    #[inline]
    fn validation_error(&self) -> Option<&'static str> {
        let finite = self.angles.is_finite() && are_finite([self.course_sd_rad, self.declination_rad]);
        quaternion_validation_error(self.quaternion)
            .or((!finite).then_some("a number that is not finite"))
            .or((self.course_sd_rad < 0.0).then_some("a negative standard deviation"))
    }
}
