//! Slot `course`: computes the attitude output for users and autopilots from `fused`, and from
//! `gnss` at the ticks that have a fix.
//!
//! - Input: the fused attitude of each tick; satellite fixes of some ticks.
//! - Output: angles, course, quaternion and the jump of the last reset, on the topic `attitude`.
//!   The course refers to true north if the launch file requests it.
//! - Time: timestamps of the samples.
//! - Failure: if a fused state is invalid, the previous attitude is published again with a flag.
#![forbid(unsafe_code)]

mod true_north;

use attitude::{
    Vector3,
    course::{Course, CourseInput},
    gnss::Fix,
    resetting::ResettingStage,
    rotation::Rotation,
    state::Attitude,
};
use host::AnyStage;
use launch::{Service, Slot};
use messages::{AttitudeOutput, Flags, FusedState, GnssFix, Header};
use runtime::{
    Join, Joined, RuntimeError, Sequence, ServiceConfig, ServiceContext, SlotProcessor, convert, join::MAX_QUEUED,
    join_inputs, serve, stage, state_words::StateWords,
};

use true_north::TrueNorth;

/// Message received on one of the slot's inputs.
#[derive(Debug, Clone, Copy)]
pub enum CourseMessage {
    /// Message of the topic `fused`.
    Fused(FusedState),
    /// Message of the topic `gnss`.
    Gnss(GnssFix),
}

impl From<FusedState> for CourseMessage {
    fn from(message: FusedState) -> Self {
        Self::Fused(message)
    }
}

impl From<GnssFix> for CourseMessage {
    fn from(message: GnssFix) -> Self {
        Self::Gnss(message)
    }
}

join_inputs! {
    /// Inputs of the join, in the order of the slot's inputs.
    Inputs => Tick { fused: FusedState, gnss: GnssFix, }
}

/// Slot `course`.
#[derive(Debug)]
pub struct CourseSlot {
    join: Join<Inputs>,
    stage: ResettingStage<AnyStage<Course>>,
    attitude: Attitude,
    /// Number of resets of the fuser, followed by the number of resets of the course.
    reset_counts: [u64; 2],
    jump: [f64; 4],
    /// Epoch of the fuser's last output.
    epoch: u32,
    swap_count: u64,
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
        stage: ResettingStage::new(stage::build_stage(Slot::Course, &config.launch, Course::from_name)?),
        attitude: Attitude::default(),
        reset_counts: [0; 2],
        jump: [1.0, 0.0, 0.0, 0.0],
        epoch: runtime::service_config::FIRST_EPOCH,
        swap_count: 0,
        north: TrueNorth::new(&config.launch.north)
            .map_err(|cause| RuntimeError::StageFailed { slot: Slot::Course, cause })?,
    })
}

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, or if the bus or the stage fails.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Course)?;
    let slot = slot(&context.config)?;
    let (fused, gnss) = (context.ordered_subscriber::<FusedState>()?, context.subscriber::<GnssFix>()?);
    serve(context, slot, &[&fused, &gnss])
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
        self.stage.failure().map(|failure| failure.to_string())
    }

    fn stage(&self) -> &AnyStage<Course> {
        &self.stage.stage
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Course> {
        &mut self.stage.stage
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.attitude.visit(visit);
        self.reset_counts.visit(visit);
        self.jump.visit(visit);
        self.epoch.visit(visit);
        self.swap_count.visit(visit);
        self.north.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        let is_finite = self.attitude.quaternion().coords.norm().is_finite() && self.jump.iter().all(|x| x.is_finite());
        (!is_finite).then_some("a number that is not finite").or(self.north.validation_error())
    }

    fn expect_backlog(&mut self, tick: u64) {
        self.join.expect_backlog(tick, MAX_QUEUED as u64);
    }
}

impl CourseSlot {
    fn compute(&mut self, input: &FusedState, mut header: Header, fix: Option<Fix>) -> Option<AttitudeOutput> {
        let received = convert::attitude(input);
        header.flags |= Flags::RESET.when(received.is_none());
        let attitude = received.unwrap_or(self.attitude);
        let is_swapped = header.flags.any(Flags::SWAPPED) && header.epoch != self.epoch;
        let is_reset = input.reset_counter != self.reset_counts[0] || is_swapped;
        self.epoch = header.epoch;
        if is_reset {
            let rotation_rad = Vector3::from(input.rate_rad_s) * header.dt_s();
            let expected = self.attitude.rotated(Rotation::from_rotation_vector(rotation_rad)).attitude;
            let jump = Rotation::between(expected, attitude).quaternion();
            self.jump = [jump.w, jump.i, jump.j, jump.k];
            self.reset_counts[0] = input.reset_counter;
            self.swap_count += u64::from(is_swapped);
        }
        self.attitude = attitude;
        let (reading, is_stage_reset) = self.stage.step(&CourseInput {
            attitude,
            reference: convert::course_reference_from_payload(input.course_reference),
            heading_sd_rad: input.heading_sd_rad,
            fix,
            dt_s: header.dt_s(),
        })?;
        let reading = self.north.apply(reading);
        // If the attitude and the course are reset at the same tick, only one reset is counted.
        self.reset_counts[1] += u64::from(reading.aligned && !is_reset);
        header.flags |= Flags::NEAR_GIMBAL.when(reading.near_gimbal)
            | Flags::ALIGNED.when(reading.aligned)
            | Flags::RESET.when(is_stage_reset);
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
            reset_counter: self.reset_counts.iter().sum::<u64>() + self.swap_count,
            jump: self.jump,
        })
    }
}

#[cfg(test)]
mod tests {
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
