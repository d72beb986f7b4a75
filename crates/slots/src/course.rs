//! Slot `course`: computes the attitude output for users and autopilots from `fused`, and from
//! `gnss` at the ticks that have a fix.
//!
//! - Input: the fused attitude of each tick; satellite fixes of some ticks.
//! - Output: angles, course, quaternion and the jump of the last reset, on the topic `attitude`.
//!   The course refers to true north if the launch file requests it.
//! - Time: timestamps of the samples.
//! - Failure: if a fused state is invalid, the previous attitude is published again with a flag.

use attitude::{
    course::{
        Course, SupervisedCourse,
        supervised::{CourseTick, SupervisedReading},
    },
    gnss::Fix,
    state_words::StateWords,
};
use host::AnyStage;
use launch::Slot;
use messages::{AttitudeOutput, Flags, FusedState, GnssFix, Header};
use runtime::{
    Join, Joined, RuntimeError, Sequence, ServiceConfig, ServiceContext, SlotInputs, SlotProcessor, convert,
    join::MAX_QUEUED, join_inputs, slot_messages, stage,
};

use crate::true_north::TrueNorth;

slot_messages! {
    CourseMessage { Fused(FusedState), Gnss(GnssFix), }
}

join_inputs! {
    /// Inputs of the join, in the order of the slot's inputs.
    Inputs => Tick { fused: FusedState, gnss: GnssFix, }
}

/// Slot `course`.
#[derive(Debug)]
pub struct CourseSlot {
    join: Join<Inputs>,
    course: SupervisedCourse<AnyStage<Course>>,
    /// Epoch of the fuser's last output.
    epoch: u32,
    north: TrueNorth,
}

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built, or if true north is requested without a valid
/// date.
pub fn slot(config: &ServiceConfig) -> Result<CourseSlot, RuntimeError> {
    Ok(CourseSlot {
        join: Join::new(Inputs::default(), config.lateness_ticks()),
        course: SupervisedCourse::new(stage::build_stage(Slot::Course, &config.launch, Course::from_name)?),
        epoch: runtime::service_config::FIRST_EPOCH,
        north: TrueNorth::new(&config.launch.north)
            .map_err(|cause| RuntimeError::StageFailed { slot: Slot::Course, cause })?,
    })
}

/// Subscribes to the inputs of the slot.
///
/// # Errors
///
/// Returns an error if the bus fails.
pub fn subscribe(context: &ServiceContext) -> Result<SlotInputs<CourseMessage>, RuntimeError> {
    Ok(vec![Box::new(context.ordered_subscriber::<FusedState>()?), Box::new(context.subscriber::<GnssFix>()?)])
}

impl SlotProcessor for CourseSlot {
    const SLOT: Slot = Slot::Course;

    type Input = CourseMessage;
    type Output = AttitudeOutput;
    type Stage = AnyStage<Course>;

    fn offer(&mut self, input: CourseMessage, publish: &mut dyn FnMut(AttitudeOutput)) {
        match input {
            CourseMessage::Fused(message) => self.join.offer(|inputs| Some(&mut inputs.fused), message),
            CourseMessage::Gnss(message) => self.join.offer(|inputs| Some(&mut inputs.gnss), message),
        }
        while let Some(Joined { missing, messages: Tick { fused, gnss }, .. }) = self.join.next() {
            let Some(state) = fused else { continue };
            let mut header = self.join.sequence().mark_header(state.header, missing);
            let fix = gnss.as_ref().and_then(convert::fix);
            if let Some(gnss) = &gnss {
                self.north.update_position(gnss);
            }
            header.flags |= Flags::AIDING_MISSING.when(header.flags.any(Flags::FIX) && fix.is_none());
            if let Some(output) = self.compute(&state, header, fix) {
                publish(output);
            }
        }
    }

    fn sequence(&self) -> &Sequence {
        self.join.sequence()
    }

    fn awaited_input(&self) -> usize {
        self.join.awaited_input()
    }

    fn failure(&self) -> Option<String> {
        self.course.validated.failure().map(|failure| failure.to_string())
    }

    fn stage(&self) -> &AnyStage<Course> {
        &self.course.validated.stage
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Course> {
        &mut self.course.validated.stage
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.course.state_mut().visit(visit);
        self.epoch.visit(visit);
        self.north.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.course.state().validation_error().or(self.north.validation_error())
    }

    fn expect_backlog(&mut self, tick: u64) {
        self.join.expect_backlog(tick, MAX_QUEUED as u64);
    }
}

impl CourseSlot {
    fn compute(&mut self, input: &FusedState, mut header: Header, fix: Option<Fix>) -> Option<AttitudeOutput> {
        let attitude = convert::attitude(input);
        header.flags |= Flags::RESET.when(attitude.is_none());
        let is_swapped = header.flags.any(Flags::SWAPPED) && header.epoch != self.epoch;
        self.epoch = header.epoch;
        let tick = CourseTick {
            attitude,
            rate_rad_s: input.rate_rad_s,
            reference: convert::course_reference_from_payload(input.course_reference),
            heading_sd_rad: input.heading_sd_rad,
            reset_counter: input.reset_counter,
            is_swapped,
            fix,
            dt_s: header.dt_s(),
        };
        let Self { course, north, .. } = self;
        let SupervisedReading { reading, is_reset, reset_counter, jump } =
            course.step(&tick, |reading| north.apply(reading))?;
        header.flags |= reading.flags() | Flags::RESET.when(is_reset);
        let q = reading.quaternion;
        Some(AttitudeOutput {
            header,
            quaternion: [q.w, q.i, q.j, q.k],
            yaw_rad: reading.angles.yaw_rad,
            pitch_rad: reading.angles.pitch_rad,
            roll_rad: reading.angles.roll_rad,
            course_rad: reading.course_rad,
            course_reference: convert::course_reference_to_payload(reading.reference),
            course_sd_rad: reading.course_sd_rad,
            declination_rad: reading.declination_rad,
            rate_rad_s: input.rate_rad_s,
            inclination_sd_rad: input.inclination_sd_rad,
            reset_counter,
            jump,
        })
    }
}

#[cfg(test)]
mod tests {
    use launch::Service;

    use super::*;

    #[test]
    fn course_joins_the_inputs_of_the_graph() {
        let mut joined = Inputs::TOPICS.to_vec();
        let mut inputs: Vec<_> = Service::Course.inputs().map(graph::Topic::name).collect();
        joined.sort_unstable();
        inputs.sort_unstable();
        assert_eq!(joined, inputs);
    }
}
