//! The reading that a course stage gives, and the last one, which it hands over.

use core::f64::consts::TAU;

use super::reference::Reference;
use crate::{
    Quaternion,
    angles::Angles,
    numbers::Numbers,
    stage::{RestoreError, Sound, UNIT},
};

/// The attitude as people read it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// Yaw, pitch, roll, in the fuser's frame.
    pub angles: Angles,
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// What the course is counted from.
    pub reference: Reference,
    /// Standard deviation of the course, rad; π where nothing is known.
    pub course_sd_rad: f64,
    /// What was added to a magnetic heading to make it a true course, rad, east positive; 0 where nothing was.
    pub declination_rad: f64,
    /// Body → the fuser's reference frame; its sign is that of the reading before, so that it does not jump.
    pub quaternion: Quaternion<f64>,
    /// Yaw and roll are not told apart here.
    pub near_gimbal: bool,
    /// The course was set anew: it jumps here although the body does not.
    pub aligned: bool,
}

impl Sound for Reading {
    fn flaw(&self) -> Option<&'static str> {
        let Angles { yaw_rad, pitch_rad, roll_rad } = self.angles;
        let numbers = [yaw_rad, pitch_rad, roll_rad, self.course_sd_rad, self.declination_rad];
        let finite = numbers.iter().all(|number| number.is_finite());
        quaternion_flaw(self.quaternion)
            .or((!finite).then_some("a number that is not finite"))
            .or((!(0.0..TAU).contains(&self.course_rad)).then_some("a course outside [0, 2π)"))
            .or((self.course_sd_rad < 0.0).then_some("a standard deviation below zero"))
    }
}

/// A course and how far it can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bearing {
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// What it is counted from.
    pub reference: Reference,
    /// Its standard deviation, rad; π where nothing is known.
    pub sd_rad: f64,
}

/// What every course stage can hand over to every other: the last reading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LastReading {
    /// Body → the fuser's reference frame.
    pub quaternion: Quaternion<f64>,
    /// The course; `None` before the first tick.
    pub bearing: Option<Bearing>,
}

impl LastReading {
    /// Refuses what is not a reading.
    pub fn checked(&self) -> Result<(), RestoreError> {
        let flaw = quaternion_flaw(self.quaternion).or_else(|| {
            let Bearing { course_rad, sd_rad, .. } = self.bearing?;
            let sound = (0.0..TAU).contains(&course_rad) && sd_rad >= 0.0;
            (!sound).then_some("a course outside [0, 2π) or a standard deviation below zero")
        });
        flaw.map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))
    }
}

impl Numbers for Reading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { angles, course_rad, reference, course_sd_rad, declination_rad, quaternion, near_gimbal, aligned } =
            self;
        let Angles { yaw_rad, pitch_rad, roll_rad } = angles;
        [yaw_rad, pitch_rad, roll_rad, course_rad].into_iter().for_each(|number| number.visit(visit));
        reference.visit(visit);
        [course_sd_rad, declination_rad].into_iter().for_each(|number| number.visit(visit));
        quaternion.visit(visit);
        near_gimbal.visit(visit);
        aligned.visit(visit);
    }
}

impl Numbers for Bearing {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { course_rad, reference, sd_rad } = self;
        course_rad.visit(visit);
        reference.visit(visit);
        sd_rad.visit(visit);
    }
}

impl Numbers for LastReading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { quaternion, bearing } = self;
        quaternion.visit(visit);
        bearing.visit(visit);
    }
}

fn quaternion_flaw(quaternion: Quaternion<f64>) -> Option<&'static str> {
    let unit = libm::fabs(quaternion.norm_squared() - 1.0) <= UNIT;
    (!unit).then_some("a quaternion that is not of unit length")
}
