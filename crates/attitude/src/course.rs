//! The course stages: from the attitude to what people read.
//!
//! Input: an attitude and what its heading is counted from; a track over ground where a receiver tells it. Output: yaw, pitch,
//! roll — Matveev 2025, (23)–(25) — the course with its reference and standard deviation, and the quaternion. Time: the interval of
//! the tick. Failure: near the vertical yaw and roll lose their meaning, and the output says so.

use core::f64::consts::TAU;

use crate::{
    Quaternion,
    angles::Angles,
    gnss::Fix,
    parameters::{Parameter, ParameterError, Parameters, settings},
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
    /// Yaw, pitch, roll.
    pub angles: Angles,
    /// Course, rad, clockwise from above, [0, 2π).
    pub course_rad: f64,
    /// What the course is counted from.
    pub reference: Reference,
    /// Standard deviation of the course, rad; π where nothing is known.
    pub course_sd_rad: f64,
    /// Body → reference; its sign is that of the reading before, so that it does not jump.
    pub quaternion: Quaternion<f64>,
    /// Yaw and roll are not told apart here.
    pub near_gimbal: bool,
}

settings! {
    /// Settings of the course stages.
    pub struct Settings {
        /// Magnetic declination, east positive; with it a magnetic course becomes a true one. 0 leaves it magnetic.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
    }
}

/// The course stage `angles`: H = −ψ.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    settings: Settings,
    before: Quaternion<f64>,
}

impl Course {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 1] = ["angles"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        (name == "angles").then(|| Self { settings: Settings::default(), before: Quaternion::new(1.0, 0.0, 0.0, 0.0) })
    }
}

impl Stage for Course {
    type Input = CourseInput;
    type Output = Reading;
    /// The quaternion of the last reading.
    type Common = Quaternion<f64>;

    fn name(&self) -> &'static str {
        "angles"
    }

    fn parameters(&self) -> &'static [Parameter] {
        Settings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &CourseInput) -> Reading {
        let angles = input.attitude.angles();
        let q = input.attitude.quaternion();
        let quaternion = if q.dot(&self.before) < 0.0 { -q } else { q };
        self.before = quaternion;
        let course_rad = if angles.yaw_rad > 0.0 { TAU - angles.yaw_rad } else { 0.0 - angles.yaw_rad };
        // A yaw too small to be seen beside 2π.
        let course_rad = if course_rad < TAU { course_rad } else { 0.0 };
        Reading {
            angles,
            course_rad,
            reference: input.reference,
            course_sd_rad: input.heading_sd_rad,
            quaternion,
            near_gimbal: libm::fabs(angles.pitch_rad) > GIMBAL_RAD,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.before.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let unit = libm::fabs(self.before.norm_squared() - 1.0) <= 1e-6;
        (!unit).then_some("a quaternion that is not of unit length")
    }

    fn common(&self) -> Quaternion<f64> {
        self.before
    }

    fn adopt(&mut self, before: &Quaternion<f64>) -> Result<(), RestoreError> {
        let adopted = Self { before: *before, ..self.clone() };
        if let Some(flaw) = adopted.flaw() {
            return Err(RestoreError::Flaw { flaw });
        }
        *self = adopted;
        Ok(())
    }
}
