//! The gyroscopic course, and how a reading goes on from the one before.

use core::f64::consts::{PI, TAU};

use super::{
    input::CourseInput,
    reading::{Bearing, LastReading, Reading},
    reference::Reference,
};
use crate::{Quaternion, angles::Angles, numbers::Numbers, stage::RestoreError};

/// |pitch| from which yaw and roll are no longer told apart, rad: 89°.
pub(crate) const GIMBAL_RAD: f64 = 1.553_343_034_274_953_3;

/// The gyroscopic course HΓ = −ψ of the fuser, made true by the declination where it is magnetic.
pub(super) fn gyroscopic(input: &CourseInput, yaw_rad: f64, declination_deg: f64) -> Bearing {
    let (turn_rad, reference) = match input.reference {
        Reference::Magnetic if declination_deg != 0.0 => (declination_deg.to_radians(), Reference::True),
        reference => (0.0, reference),
    };
    let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
    Bearing { course_rad: course_of_rad(turn_rad - yaw_rad), reference, sd_rad }
}

/// An angle of a few turns at most in [0, 2π).
pub(super) fn course_of_rad(angle_rad: f64) -> f64 {
    let positive = angle_rad - TAU * libm::floor(angle_rad / TAU);
    // One too small to be seen beside 2π; also makes −0 a 0.
    if positive < TAU { positive + 0.0 } else { 0.0 }
}

/// What stays of one reading for the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Continuity {
    quaternion: Quaternion<f64>,
    pub(super) bearing: Bearing,
    pub(super) told: bool,
}

impl Default for Continuity {
    fn default() -> Self {
        let bearing = Bearing { course_rad: 0.0, reference: Reference::Arbitrary, sd_rad: PI };
        Self { quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0), bearing, told: false }
    }
}

impl Continuity {
    /// The reading of an attitude with this course.
    pub(super) fn read(
        &mut self,
        input: &CourseInput,
        angles: Angles,
        bearing: Bearing,
        declination_deg: f64,
        aligned: bool,
    ) -> Reading {
        let q = input.attitude.quaternion();
        let quaternion = if q.dot(&self.quaternion) < 0.0 { -q } else { q };
        let made_true = input.reference == Reference::Magnetic && bearing.reference == Reference::True;
        *self = Self { quaternion, bearing, told: true };
        Reading {
            angles,
            course_rad: bearing.course_rad,
            reference: bearing.reference,
            course_sd_rad: bearing.sd_rad,
            declination_rad: if made_true { declination_deg.to_radians() } else { 0.0 },
            quaternion,
            near_gimbal: libm::fabs(angles.pitch_rad) > GIMBAL_RAD,
            aligned,
        }
    }

    pub(super) fn last(&self) -> LastReading {
        LastReading { quaternion: self.quaternion, bearing: self.told.then_some(self.bearing) }
    }

    pub(super) fn of(last: &LastReading) -> Result<Self, RestoreError> {
        last.checked()?;
        let bearing = last.bearing.unwrap_or(Self::default().bearing);
        Ok(Self { quaternion: last.quaternion, bearing, told: last.bearing.is_some() })
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        self.last().checked().err().map(|_| "a reading that is none")
    }
}

impl Numbers for Continuity {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.quaternion.visit(visit);
        self.bearing.course_rad.visit(visit);
        self.bearing.reference.visit(visit);
        self.bearing.sd_rad.visit(visit);
        self.told.visit(visit);
    }
}
