//! The slot `course`: from `fused`, with `gnss` where a tick has it, to `attitude`: what people and autopilots read.
//!
//! Input: the fused attitude of each tick, a fix of some. Output: angles, course, quaternion, and the jump whenever the attitude was
//! set anew; the course from true north where the launch file asks for it. Time: the samples' own. Failure: a state that is not an attitude repeats the last one, flagged.
#![forbid(unsafe_code)]

mod true_north;

use attitude::{
    Vector3,
    course::{Course, CourseInput},
    gnss::Fix,
    state::Attitude,
    turn::Turn,
};
use host::AnyStage;
use launch::Service;
use messages::{AttitudeOutput, Flags, FusedState, GnssFix, Header};
use runtime::{
    Join, Joined, RuntimeError, Sequence, ServiceConfig, ServiceContext, Slot,
    join::QUEUE_MAX,
    lanes, quantities, serve,
    stage::{self, Filled},
    state_words::Words,
};

use true_north::TrueNorth;

/// What the slot reads.
#[derive(Debug, Clone, Copy)]
pub enum CourseMessage {
    /// Of the topic `fused`.
    Fused(FusedState),
    /// Of the topic `gnss`.
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

lanes! {
    /// What the slot joins, in the order in which it is read.
    Inputs => Tick { fused: FusedState, gnss: GnssFix, }
}

/// The slot.
#[derive(Debug)]
pub struct CourseSlot {
    join: Join<Inputs>,
    filled: Filled<AnyStage<Course>>,
    attitude: Attitude,
    /// The fuser's, and those of the course itself.
    resets: [u64; 2],
    jump: [f64; 4],
    /// The decision under which the fuser published last, and how often another kind of fuser took over.
    epoch: u32,
    swaps: u64,
    north: TrueNorth,
}

/// The slot with the stage that `config` names.
pub fn slot(config: &ServiceConfig) -> Result<CourseSlot, RuntimeError> {
    Ok(CourseSlot {
        join: Join::new(Inputs::default(), config.lateness_ticks()),
        filled: Filled::new(stage::chosen(Service::Course, &config.launch, Course::named)?),
        attitude: Attitude::default(),
        resets: [0; 2],
        jump: [1.0, 0.0, 0.0, 0.0],
        epoch: runtime::service_config::FIRST_EPOCH,
        swaps: 0,
        north: TrueNorth::new(&config.launch.north)
            .map_err(|why| RuntimeError::Failed { slot: Service::Course, why })?,
    })
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Course)?;
    let slot = slot(&context.config)?;
    let (fused, gnss) = (context.reader::<FusedState>()?, context.subscriber::<GnssFix>()?);
    serve(context, slot, &[&fused, &gnss])
}

impl Slot for CourseSlot {
    type Input = CourseMessage;
    type Output = AttitudeOutput;
    type Stage = AnyStage<Course>;

    fn offer(&mut self, input: CourseMessage, publish: &mut dyn FnMut(AttitudeOutput)) {
        match input {
            CourseMessage::Fused(message) => self.join.offer(|inputs| Some(&mut inputs.fused), message),
            CourseMessage::Gnss(message) => self.join.offer(|inputs| Some(&mut inputs.gnss), message),
        }
        while let Some(Joined { missing, parts: Tick { fused, gnss }, .. }) = self.join.take() {
            let Some(state) = fused else { continue };
            let mut header = self.join.sequence().mark(state.header, missing);
            let fix = gnss.as_ref().and_then(quantities::fix);
            if let Some(gnss) = &gnss {
                self.north.note(gnss);
            }
            header.flags |= Flags::AIDING_MISSING.when(header.flags.any(Flags::FIX) && fix.is_none());
            if let Some(output) = self.read(&state, header, fix) {
                publish(output);
            }
        }
    }

    fn sequence(&self) -> &Sequence {
        self.join.sequence()
    }

    fn lacks(&self) -> usize {
        self.join.lacks()
    }

    fn failure(&self) -> Option<String> {
        self.filled.failure()
    }

    fn stage(&self) -> &AnyStage<Course> {
        &self.filled.stage
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Course> {
        &mut self.filled.stage
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.attitude.visit(visit);
        self.resets.visit(visit);
        self.jump.visit(visit);
        self.epoch.visit(visit);
        self.swaps.visit(visit);
        self.north.visit(visit);
    }

    fn own_flaw(&self) -> Option<&'static str> {
        let finite = self.attitude.quaternion().coords.norm().is_finite() && self.jump.iter().all(|x| x.is_finite());
        (!finite).then_some("a number that is not finite").or(self.north.flaw())
    }

    fn expect_until(&mut self, tick: u64) {
        self.join.expect_until(tick, QUEUE_MAX as u64);
    }
}

impl CourseSlot {
    fn read(&mut self, input: &FusedState, mut header: Header, fix: Option<Fix>) -> Option<AttitudeOutput> {
        let seen = quantities::attitude(input);
        header.flags |= Flags::RESET.when(seen.is_none());
        let attitude = seen.unwrap_or(self.attitude);
        let swapped = header.flags.any(Flags::SWAPPED) && header.epoch != self.epoch;
        let reset = input.reset_counter != self.resets[0] || swapped;
        self.epoch = header.epoch;
        if reset {
            let rotation_rad = Vector3::from(input.rate_rad_s) * header.dt_s();
            let expected = self.attitude.turned(Turn::of_rotation_vector(rotation_rad)).attitude;
            let jump = Turn::between(expected, attitude).quaternion();
            self.jump = [jump.w, jump.i, jump.j, jump.k];
            self.resets[0] = input.reset_counter;
            self.swaps += u64::from(swapped);
        }
        self.attitude = attitude;
        let (reading, anew) = self.filled.step(&CourseInput {
            attitude,
            reference: quantities::course_reference(input.course_reference),
            heading_sd_rad: input.heading_sd_rad,
            fix,
            dt_s: header.dt_s(),
        })?;
        let reading = self.north.apply(reading);
        // Where the attitude was set anew too, it counts once.
        self.resets[1] += u64::from(reading.aligned && !reset);
        header.flags |= Flags::NEAR_GIMBAL.when(reading.near_gimbal)
            | Flags::ALIGNED.when(reading.aligned)
            | Flags::RESET.when(anew);
        let q = reading.quaternion;
        Some(AttitudeOutput {
            header,
            quaternion: [q.w, q.i, q.j, q.k],
            yaw_rad: reading.angles.yaw_rad,
            pitch_rad: reading.angles.pitch_rad,
            roll_rad: reading.angles.roll_rad,
            course_rad: reading.course_rad,
            course_reference: quantities::course_reference_of(reading.reference),
            course_sd_rad: reading.course_sd_rad,
            declination_rad: reading.declination_rad,
            rate_rad_s: input.rate_rad_s,
            inclination_sd_rad: input.inclination_sd_rad,
            reset_counter: self.resets.iter().sum::<u64>() + self.swaps,
            jump: self.jump,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slot_joins_the_inputs_that_the_graph_gives_it() {
        let mut joined = Inputs::TOPICS.to_vec();
        let mut inputs: Vec<_> = Service::Course.inputs().map(graph::Topic::name).collect();
        joined.sort_unstable();
        inputs.sort_unstable();
        assert_eq!(joined, inputs);
    }
}
