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
mod registry;
pub mod supervised;
mod track;

pub use angles::{AnglesCourse, AnglesSettings};
pub(crate) use continuity::GIMBAL_RAD;
pub use deferred::{DeferredAngles, DeferredReading};
pub use input::CourseInput;
pub use reading::{CourseEstimate, CourseReading, LastReading};
pub use reference::CourseReference;
pub use registry::Course;
pub use supervised::SupervisedCourse;
pub use track::{TrackCourse, TrackSettings};
