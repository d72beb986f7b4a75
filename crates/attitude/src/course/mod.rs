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
mod track;

pub use angles::{AnglesSettings, OfAngles};
pub use track::{OfTrack, TrackSettings};

use core::f64::consts::{PI, TAU};

use crate::{
    Quaternion,
    angles::Angles,
    gnss::Fix,
    parameters::{Parameter, ParameterError},
    stage::{Numbers, RestoreError, Stage},
    state::Attitude,
};

/// |pitch| from which yaw and roll are no longer told apart, rad: 89°.
const GIMBAL_RAD: f64 = 1.553_343_034_274_953_3;

/// From which direction a course is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reference {
    /// From wherever the attitude began: gyro and accelerometer alone cannot know north.
    #[default]
    Arbitrary,
    /// From magnetic north.
    Magnetic,
    /// From true north.
    True,
}

impl Numbers for Reference {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut value = match self {
            Self::Arbitrary => 0.0,
            Self::Magnetic => 1.0,
            Self::True => 2.0,
        };
        visit(&mut value);
        *self = match value {
            value if value > 1.5 => Self::True,
            value if value > 0.5 => Self::Magnetic,
            _ => Self::Arbitrary,
        };
    }
}

/// What the course slot is offered at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CourseInput {
    /// The fused attitude.
    pub attitude: Attitude,
    /// What its heading is counted from.
    pub reference: Reference,
    /// Standard deviation of its heading, rad.
    pub heading_sd_rad: f64,
    /// Of the satellite receiver, at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Length of the tick's interval, s.
    pub dt_s: f64,
}

/// The attitude as people read it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Yaw, pitch, roll, in the fuser's frame.
    pub angles: Angles,
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// What the course is counted from.
    pub reference: Reference,
    /// Standard deviation of the course, rad; π where nothing is known.
    pub course_sd_rad: f64,
    /// Body → the fuser's reference frame; its sign is that of the reading before, so that it does not jump.
    pub quaternion: Quaternion<f64>,
    /// Yaw and roll are not told apart here.
    pub near_gimbal: bool,
    /// The course was set anew: it jumps here although the body does not.
    pub aligned: bool,
}

/// A course and how far it can be believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bearing {
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// What it is counted from.
    pub reference: Reference,
    /// Its standard deviation, rad; π where nothing is known.
    pub sd_rad: f64,
}

/// What every course stage can hand over to every other: the last reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LastReading {
    /// Body → the fuser's reference frame.
    pub quaternion: Quaternion<f64>,
    /// The course; `None` before the first tick.
    pub bearing: Option<Bearing>,
}

impl LastReading {
    fn checked(&self) -> Result<(), RestoreError> {
        let flaw = quaternion_flaw(self.quaternion).or_else(|| {
            let Bearing { course_rad, sd_rad, .. } = self.bearing?;
            let sound = (0.0..TAU).contains(&course_rad) && sd_rad >= 0.0;
            (!sound).then_some("a course outside [0, 2π) or a standard deviation below zero")
        });
        flaw.map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))
    }
}

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

/// The gyroscopic course HΓ = −ψ of the fuser, made true by the declination where it is magnetic.
fn gyroscopic(input: &CourseInput, yaw_rad: f64, declination_deg: f64) -> Bearing {
    let (turn_rad, reference) = match input.reference {
        Reference::Magnetic if declination_deg != 0.0 => (declination_deg.to_radians(), Reference::True),
        reference => (0.0, reference),
    };
    let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
    Bearing { course_rad: course_of_rad(turn_rad - yaw_rad), reference, sd_rad }
}

/// An angle of a few turns at most in [0, 2π).
fn course_of_rad(angle_rad: f64) -> f64 {
    let positive = angle_rad - TAU * libm::floor(angle_rad / TAU);
    // One too small to be seen beside 2π; also makes −0 a 0.
    if positive < TAU { positive + 0.0 } else { 0.0 }
}

/// What stays of one reading for the next.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Continuity {
    quaternion: Quaternion<f64>,
    bearing: Bearing,
    told: bool,
}

impl Default for Continuity {
    fn default() -> Self {
        let bearing = Bearing { course_rad: 0.0, reference: Reference::Arbitrary, sd_rad: PI };
        Self { quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0), bearing, told: false }
    }
}

impl Continuity {
    /// The reading of an attitude with this course.
    fn read(&mut self, attitude: Attitude, angles: Angles, bearing: Bearing, aligned: bool) -> Reading {
        let q = attitude.quaternion();
        let quaternion = if q.dot(&self.quaternion) < 0.0 { -q } else { q };
        *self = Self { quaternion, bearing, told: true };
        Reading {
            angles,
            course_rad: bearing.course_rad,
            reference: bearing.reference,
            course_sd_rad: bearing.sd_rad,
            quaternion,
            near_gimbal: libm::fabs(angles.pitch_rad) > GIMBAL_RAD,
            aligned,
        }
    }

    fn last(&self) -> LastReading {
        LastReading { quaternion: self.quaternion, bearing: self.told.then_some(self.bearing) }
    }

    fn of(last: &LastReading) -> Result<Self, RestoreError> {
        last.checked()?;
        let bearing = last.bearing.unwrap_or(Self::default().bearing);
        Ok(Self { quaternion: last.quaternion, bearing, told: last.bearing.is_some() })
    }

    fn flaw(&self) -> Option<&'static str> {
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

fn quaternion_flaw(quaternion: Quaternion<f64>) -> Option<&'static str> {
    let unit = libm::fabs(quaternion.norm_squared() - 1.0) <= 1e-6;
    (!unit).then_some("a quaternion that is not of unit length")
}
