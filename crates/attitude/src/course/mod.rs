//! The course stages: from the attitude to what people read.
//!
//! Input: an attitude and what its heading is counted from; a track over ground where a receiver tells it. Output: yaw, pitch,
//! roll — Matveev 2025, (23)–(25) — the course with its reference and standard deviation, and the quaternion. Time: the interval of
//! the tick. Failure: near the vertical yaw and roll lose their meaning, and the output says so.
//!
//! | stage | course | counted from |
//! | --- | --- | --- |
//! | [`angles`](OfAngles) | H = −ψ, plus the declination where the heading is magnetic | what the fuser's heading is counted from; true north with a declination |
//! | [`track`](OfTrack) | the gyroscopic course, drawn to the track over ground | true north from the first track on; before it as `angles` |
//!
//! Yaw, the angles and the quaternion stay in the fuser's frame whatever the course is counted from: the quaternion turns with the
//! body alone, and an autopilot that flies by it sees no step when a track sets the course.
//!
//! | sensors | fuser's heading | `angles` | `track` |
//! | --- | --- | --- | --- |
//! | gyro, accelerometer | arbitrary | arbitrary | arbitrary |
//! | and a magnetometer | magnetic | magnetic; true with a declination | the same |
//! | and a receiver, moving | arbitrary, or true in a stage that takes tracks | as the fuser | true |
//! | and both | magnetic or true | as the fuser; true with a declination | true |
//!
//! `track` tells where a vehicle goes, and so, without wind and side slip, where it points. Behind a fuser that finds true north by
//! accelerations, `angles` tells where it points in wind, too.

mod angles;
mod continuity;
mod input;
mod reading;
mod reference;
mod track;

pub use angles::{AnglesSettings, OfAngles};
pub(crate) use continuity::GIMBAL_RAD;
pub use input::CourseInput;
pub use reading::{Bearing, LastReading, Reading};
pub use reference::Reference;
pub use track::{OfTrack, TrackSettings};

use crate::{
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Stage},
};

/// A course stage.
#[derive(Debug, Clone, PartialEq)]
pub enum Course {
    /// `angles`
    Angles(OfAngles),
    /// `track`
    Track(OfTrack),
}

impl Course {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 2] = ["angles", "track"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "angles" => Some(Self::Angles(OfAngles::default())),
            "track" => Some(Self::Track(OfTrack::default())),
            _ => None,
        }
    }
}

macro_rules! each {
    ($course:expr, $stage:ident => $do:expr) => {
        match $course {
            Course::Angles($stage) => $do,
            Course::Track($stage) => $do,
        }
    };
}

impl Stage for Course {
    type Input = CourseInput;
    type Output = Reading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        each!(self, stage => stage.name())
    }

    fn parameters(&self) -> &'static [Parameter] {
        each!(self, stage => stage.parameters())
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        each!(self, stage => stage.set(name, value))
    }

    fn step(&mut self, input: &CourseInput) -> Reading {
        each!(self, stage => stage.step(input))
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        each!(self, stage => stage.visit_state(visit));
    }

    fn flaw(&self) -> Option<&'static str> {
        each!(self, stage => stage.flaw())
    }

    fn common(&self) -> LastReading {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, common: &LastReading) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(common))
    }
}
