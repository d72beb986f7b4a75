//! Gyroscopic course, and continuity between successive readings.

use core::f64::consts::{PI, TAU};

use super::{
    input::CourseInput,
    reading::{CourseEstimate, CourseReading, LastReading},
    reference::CourseReference,
};
use crate::{Quaternion, angles::Angles, scalars::scalars, stage::RestoreError};

/// |pitch| above which yaw and roll cannot be separated, rad (89°).
pub(crate) const GIMBAL_RAD: f64 = 1.553_343_034_274_953_3;

/// Returns the gyroscopic course HΓ = −ψ, where ψ is the fuser's yaw. The declination converts a
/// magnetic course to a true one.
#[inline]
pub(super) fn gyroscopic_course(input: &CourseInput, yaw_rad: f64, declination_deg: f64) -> CourseEstimate {
    let (correction_rad, reference) = match input.reference {
        CourseReference::Magnetic if declination_deg != 0.0 => (declination_deg.to_radians(), CourseReference::True),
        reference => (0.0, reference),
    };
    let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
    CourseEstimate { course_rad: wrap_course_rad(correction_rad - yaw_rad), reference, sd_rad }
}

/// Wraps an angle of a few revolutions to [0, 2π).
#[inline]
pub(super) fn wrap_course_rad(angle_rad: f64) -> f64 {
    let positive = angle_rad - TAU * libm::floor(angle_rad / TAU);
    // Wrapping a tiny negative angle rounds to 2π, which is outside the range. Adding 0 turns −0
    // into 0.
    if positive < TAU { positive + 0.0 } else { 0.0 }
}

/// State kept from the previous reading for the next one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Continuity {
    quaternion: Quaternion<f64>,
    pub(super) course: CourseEstimate,
    pub(super) has_reading: bool,
}

impl Default for Continuity {
    fn default() -> Self {
        let course = CourseEstimate { course_rad: 0.0, reference: CourseReference::Arbitrary, sd_rad: PI };
        Self { quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0), course, has_reading: false }
    }
}

impl Continuity {
    /// Returns the reading with the given angles and course, and stores it for the next call.
    #[inline]
    pub(super) fn next_reading(
        &mut self,
        input: &CourseInput,
        angles: Angles,
        course: CourseEstimate,
        declination_deg: f64,
        aligned: bool,
    ) -> CourseReading {
        let q = input.attitude.quaternion();
        let quaternion = if q.dot(&self.quaternion) < 0.0 { -q } else { q };
        let corrected = input.reference == CourseReference::Magnetic && course.reference == CourseReference::True;
        *self = Self { quaternion, course, has_reading: true };
        CourseReading {
            angles,
            course_rad: course.course_rad,
            reference: course.reference,
            course_sd_rad: course.sd_rad,
            declination_rad: if corrected { declination_deg.to_radians() } else { 0.0 },
            quaternion,
            near_gimbal: libm::fabs(angles.pitch_rad) > GIMBAL_RAD,
            aligned,
        }
    }

    pub(super) fn last(&self) -> LastReading {
        LastReading { quaternion: self.quaternion, course: self.has_reading.then_some(self.course) }
    }

    pub(super) fn from_last(last: &LastReading) -> Result<Self, RestoreError> {
        last.validate()?;
        let course = last.course.unwrap_or(Self::default().course);
        Ok(Self { quaternion: last.quaternion, course, has_reading: last.course.is_some() })
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        self.last().validate().err().map(|_| "an invalid previous reading")
    }
}

scalars!(Continuity: quaternion, course, has_reading);
