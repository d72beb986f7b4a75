//! The slot `course`: from `fused` to `attitude`, what people and autopilots read.
//!
//! Input: the fused attitude of each tick. Output: angles, course, quaternion, and the jump whenever the attitude was set anew.
//! Time: the samples' own. Failure: a state that is not an attitude repeats the last one, flagged.
#![forbid(unsafe_code)]

use attitude::{
    Vector3,
    course::{Course, CourseInput, Reference},
    stage::Stage,
    state::Attitude,
    turn::Turn,
};
use launch::Service;
use messages::{AttitudeOutput, CourseReference, Flags, FusedState, Header};
use runtime::{EachTick, Member, Orders, RuntimeError, Work, filled, serve};

/// The work of the slot.
#[derive(Debug, Clone)]
pub struct CourseWork {
    stage: Course,
    attitude: Attitude,
    reset_counter: u64,
    jump: [f64; 4],
}

/// The slot with the stage that `orders` name.
pub fn slot(orders: &Orders) -> Result<EachTick<CourseWork>, RuntimeError> {
    let stage = filled(Service::Course, &orders.launch.course, Course::named)?;
    let jump = [1.0, 0.0, 0.0, 0.0];
    Ok(EachTick::new(CourseWork { stage, attitude: Attitude::default(), reset_counter: 0, jump }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let member = Member::join(Service::Course)?;
    let slot = slot(&member.orders)?;
    let fused = member.subscriber::<FusedState>()?;
    serve(member, slot, &[&fused])
}

impl Work for CourseWork {
    type Input = FusedState;
    type Output = AttitudeOutput;

    fn work(&mut self, input: &FusedState, mut header: Header) -> AttitudeOutput {
        let seen = input.attitude();
        header.flags |= Flags::RESET.when(seen.is_none());
        let attitude = seen.unwrap_or(self.attitude);
        if input.reset_counter != self.reset_counter {
            let rotation_rad = Vector3::from(input.rate_rad_s) * header.dt_s();
            let expected = self.attitude.turned(Turn::of_rotation_vector(rotation_rad)).attitude;
            let jump = Turn::between(expected, attitude).quaternion();
            self.jump = [jump.w, jump.i, jump.j, jump.k];
            self.reset_counter = input.reset_counter;
        }
        self.attitude = attitude;
        let reading = self.stage.step(&CourseInput {
            attitude,
            reference: Reference::Arbitrary,
            heading_sd_rad: std::f64::consts::PI,
            fix: None,
            dt_s: header.dt_s(),
        });
        header.flags |= Flags::NEAR_GIMBAL.when(reading.near_gimbal);
        let q = reading.quaternion;
        AttitudeOutput {
            header,
            quaternion: [q.w, q.i, q.j, q.k],
            yaw_rad: reading.angles.yaw_rad,
            pitch_rad: reading.angles.pitch_rad,
            roll_rad: reading.angles.roll_rad,
            course_rad: reading.course_rad,
            course_reference: CourseReference::ARBITRARY,
            rate_rad_s: input.rate_rad_s,
            inclination_sd_rad: input.inclination_sd_rad,
            reset_counter: self.reset_counter,
            jump: self.jump,
        }
    }
}
