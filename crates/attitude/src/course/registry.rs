//! Registry of the course stages: name and type of each built-in stage.

use super::{AnglesCourse, CourseInput, CourseReading, DeferredReading, LastReading, TrackCourse};
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
