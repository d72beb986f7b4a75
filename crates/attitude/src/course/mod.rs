//! Course stages: compute angles, course and quaternion from the attitude.
//!
//! Input: an attitude and the reference of its heading, and a track over ground if a receiver
//! provides one.
//!
//! Output: yaw, pitch, roll — Matveev 2025, (23)–(25) — the course with its reference and standard
//! deviation, and the quaternion.
//!
//! Time: each step receives the length of the tick's interval.
//!
//! Failure: near the vertical, yaw and roll lose their meaning and the output is flagged.
//!
//! - [`angles`](AnglesCourse): the course is H = −ψ, where ψ is the yaw, plus the declination if
//!   the heading is magnetic. The course has the reference of the fuser's heading, or true north if
//!   a declination was added.
//! - [`track`](TrackCourse): gyroscopic course, corrected towards the track over ground. The course
//!   refers to true north from the first track onwards; before that it equals the course of
//!   `angles`.
//!
//! The angles and the quaternion stay in the fuser's frame, regardless of the course reference. The
//! quaternion changes only with the rotation of the body, so an autopilot that uses it sees no step
//! when a track sets the course.
//!
//! | sensors | fuser's heading | `angles` | `track` |
//! | --- | --- | --- | --- |
//! | gyro, accelerometer | arbitrary | arbitrary | arbitrary |
//! | plus magnetometer | magnetic | magnetic; true with a declination | as `angles` |
//! | plus receiver, moving | arbitrary, or true in a stage that uses tracks | as the fuser | true |
//! | plus both | magnetic or true | as the fuser; true with a declination | true |
//!
//! `track` reports the direction of travel, which is the direction of the nose if there is no wind
//! and no side slip. With a fuser that finds true north from accelerations, `angles` reports the
//! direction of the nose even in wind.

mod angles;
mod continuity;
mod deferred;
mod input;
mod reading;
mod reference;
pub mod supervised;
mod track;

pub use angles::{AnglesCourse, AnglesSettings};
pub(crate) use continuity::GIMBAL_RAD;
pub use deferred::{DeferredAngles, DeferredReading};
pub use input::CourseInput;
pub use reading::{CourseEstimate, CourseReading, LastReading};
pub use reference::CourseReference;
pub use supervised::SupervisedCourse;
pub use track::{TrackCourse, TrackSettings};

use crate::stage::{Stage, forward_stage};

/// Course stage.
#[derive(Debug, Clone, PartialEq)]
pub enum Course {
    /// Course from the fuser's yaw.
    Angles(AnglesCourse),
    /// Gyroscopic course, corrected towards the track over ground.
    Track(TrackCourse),
}

impl Default for Course {
    /// Returns the stage `angles`.
    fn default() -> Self {
        Self::Angles(AnglesCourse::default())
    }
}

impl Course {
    /// Names of the stages; the first is the default.
    pub const NAMES: [&'static str; 2] = ["angles", "track"];

    /// Creates the stage with the given name, or returns `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "angles" => Some(Self::Angles(AnglesCourse::default())),
            "track" => Some(Self::Track(TrackCourse::default())),
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

impl Course {
    /// Processes a tick like [`step`](Stage::step), but computes the angles only if the stage needs
    /// them.
    ///
    /// After the last tick, the state needs [`store_course`](Self::store_course).
    #[inline(always)]
    pub fn step_deferred(&mut self, input: &CourseInput) -> DeferredReading {
        match self {
            Self::Angles(stage) => stage.step_deferred(input),
            Self::Track(stage) => {
                // A copy, because a reference would keep the whole input in memory for both stages.
                let input = *input;
                DeferredReading::from_reading(input.attitude, &stage.step(&input))
            }
        }
    }

    /// Completes the state with the course of the newest [`DeferredReading`], rad.
    pub fn store_course(&mut self, course_rad: f64) {
        match self {
            Self::Angles(stage) => stage.store_course(course_rad),
            // The stage has computed the course itself.
            Self::Track(_) => {}
        }
    }
}

impl Stage for Course {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;

    forward_stage!(each);
}
