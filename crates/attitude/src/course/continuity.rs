//! Gyroscopic course, and continuity between successive readings.

use core::f64::consts::{PI, TAU};

use super::{
    input::CourseInput,
    reading::{CourseEstimate, CourseReading, LastReading},
    reference::CourseReference,
};
use crate::{Quaternion, angles::Angles, scalars::scalars, stage::RestoreError, state::Attitude};

/// |pitch| above which yaw and roll cannot be separated, rad (89°).
pub(crate) const GIMBAL_RAD: f64 = 1.553_343_034_274_953_3;

/// Returns the gyroscopic course HΓ = −ψ, where ψ is the fuser's yaw. The declination converts a
/// magnetic course to a true one.
#[inline]
pub(super) fn gyroscopic_course(input: &CourseInput, yaw_rad: f64, declination_deg: f64) -> CourseEstimate {
    let (declination_rad, reference) = corrected_reference(input, declination_deg);
    let course_rad = wrap_course_rad(declination_rad - yaw_rad);
    CourseEstimate { course_rad, reference, sd_rad: heading_sd_rad(input) }
}

/// Returns the declination that is added to the heading, rad, and the reference of the course.
#[inline]
pub(super) fn corrected_reference(input: &CourseInput, declination_deg: f64) -> (f64, CourseReference) {
    match input.reference {
        CourseReference::Magnetic if declination_deg != 0.0 => (declination_deg.to_radians(), CourseReference::True),
        reference => (0.0, reference),
    }
}

/// Returns the standard deviation of the fuser's heading, rad, at most π.
#[inline]
pub(super) fn heading_sd_rad(input: &CourseInput) -> f64 {
    if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI }
}

/// Returns `true` if the angles have a pitch at which yaw and roll cannot be separated.
#[inline]
fn is_near_gimbal(angles: Angles) -> bool {
    libm::fabs(angles.pitch_rad) > GIMBAL_RAD
}

/// Returns [`is_near_gimbal`] for the angles of an attitude. The angles are computed only if the
/// pitch is above 88° or not a number.
#[inline]
pub(super) fn has_near_gimbal_angles(attitude: Attitude) -> bool {
    /// sin² 88°, with a margin below sin² 89° that is far above the rounding errors.
    const SQUARED_SINE: f64 = 0.998_782;
    let (u, v) = (attitude.up.w.re, attitude.up.w.im);
    // sin ϑ = ±2 v/(1 + u² + v²)
    let (doubled, scale) = (2.0 * v, 1.0 + (u * u + v * v));
    let is_certainly_below = doubled * doubled < SQUARED_SINE * (scale * scale);
    !is_certainly_below && is_near_gimbal(attitude.angles())
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
    pub(super) quaternion: Quaternion<f64>,
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
        let quaternion = self.next_quaternion(input.attitude);
        let corrected = input.reference == CourseReference::Magnetic && course.reference == CourseReference::True;
        *self = Self { quaternion, course, has_reading: true };
        CourseReading {
            angles,
            course_rad: course.course_rad,
            reference: course.reference,
            course_sd_rad: course.sd_rad,
            declination_rad: if corrected { declination_deg.to_radians() } else { 0.0 },
            quaternion,
            near_gimbal: is_near_gimbal(angles),
            aligned,
        }
    }

    /// Returns the quaternion of an attitude with the sign that continues the previous reading.
    #[inline]
    pub(super) fn next_quaternion(&self, attitude: Attitude) -> Quaternion<f64> {
        let q = attitude.quaternion();
        if q.dot(&self.quaternion) < 0.0 { -q } else { q }
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
