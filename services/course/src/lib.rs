//! The slot `course`: from `fused`, with `gnss` where a tick has it, to `attitude`: what people and autopilots read.
//!
//! Input: the fused attitude of each tick, a fix of some. Output: angles, course, quaternion, and the jump whenever the attitude was
//! set anew. Time: the samples' own. Failure: a state that is not an attitude repeats the last one, flagged.
#![forbid(unsafe_code)]

use std::collections::VecDeque;

use attitude::{
    Vector3,
    course::{Course, CourseInput, LastReading, Reading, Reference},
    gnss::Fix,
    stage::Stage,
    state::Attitude,
    turn::Turn,
};
use launch::Service;
use messages::{AttitudeOutput, CourseReference, Flags, FusedState, GnssFix, Header, Ticked};
use runtime::{Beside, Member, Orders, RuntimeError, Sequence, Slot, serve, stage, words::Words};

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

/// A stage that the slot takes.
pub trait CourseStage: Stage<Input = CourseInput, Output = Reading, Common = LastReading> + Clone {}

impl<S: Stage<Input = CourseInput, Output = Reading, Common = LastReading> + Clone> CourseStage for S {}

/// The slot.
#[derive(Debug, Clone)]
pub struct CourseSlot<S = Course> {
    queue: VecDeque<FusedState>,
    fixes: Beside<GnssFix>,
    sequence: Sequence,
    stage: S,
    declination_rad: f64,
    attitude: Attitude,
    /// The fuser's, and those of the course itself.
    resets: [u64; 2],
    jump: [f64; 4],
    /// The decision under which the fuser published last, and how often another kind of fuser took over.
    epoch: u32,
    exchanges: u64,
}

/// The slot with the stage that `orders` name.
pub fn slot(orders: &Orders) -> Result<CourseSlot, RuntimeError> {
    slot_with(orders, Course::named)
}

fn slot_with<S: CourseStage>(
    orders: &Orders,
    named: impl FnOnce(&str) -> Option<S>,
) -> Result<CourseSlot<S>, RuntimeError> {
    Ok(CourseSlot {
        queue: VecDeque::new(),
        fixes: Beside::new(Flags::FIX, orders.lateness_ticks()),
        sequence: Sequence::default(),
        stage: stage::filled(Service::Course, &orders.launch.course, named)?,
        declination_rad: orders.launch.course.set.get("declination_deg").map_or(0.0, |deg| deg.to_radians()),
        attitude: Attitude::default(),
        resets: [0; 2],
        jump: [1.0, 0.0, 0.0, 0.0],
        epoch: runtime::service::FIRST_EPOCH,
        exchanges: 0,
    })
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    run_with(Course::named)
}

/// The service with stages of one's own: `named` makes the one of that name.
pub fn run_with<S: CourseStage>(named: impl FnOnce(&str) -> Option<S>) -> Result<(), RuntimeError> {
    let member = Member::join(Service::Course)?;
    let slot = slot_with(&member.orders, named)?;
    let (fused, gnss) = (member.reader::<FusedState>()?, member.subscriber::<GnssFix>()?);
    serve(member, slot, &[&fused, &gnss])
}

impl<S: CourseStage> Slot for CourseSlot<S> {
    type Input = CourseMessage;
    type Output = AttitudeOutput;
    type Stage = S;

    fn offer(&mut self, input: CourseMessage, publish: &mut dyn FnMut(AttitudeOutput)) {
        match input {
            CourseMessage::Fused(message) => self.queue.push_back(message),
            CourseMessage::Gnss(message) => self.fixes.offer(message),
        }
        while !self.waits_for_fix() {
            let Some(state) = self.queue.pop_front() else { break };
            if let Some(missing) = self.sequence.admit(&state.header) {
                let mut header = self.sequence.mark(state.header, missing);
                let fix = self.fixes.take(header.tick).and_then(|gnss| gnss.fix());
                header.flags |= Flags::AIDING_MISSING.when(header.flags.any(Flags::FIX) && fix.is_none());
                publish(self.read(&state, header, fix));
            }
        }
    }

    fn sequence(&self) -> &Sequence {
        &self.sequence
    }

    fn lacks(&self) -> usize {
        usize::from(self.waits_for_fix())
    }

    fn stage(&self) -> &S {
        &self.stage
    }

    fn stage_mut(&mut self) -> &mut S {
        &mut self.stage
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.sequence.visit(visit);
        self.attitude.visit(visit);
        self.resets.visit(visit);
        self.jump.visit(visit);
        self.epoch.visit(visit);
        self.exchanges.visit(visit);
    }

    fn own_flaw(&self) -> Option<&'static str> {
        let finite = self.attitude.quaternion().coords.norm().is_finite() && self.jump.iter().all(|x| x.is_finite());
        (!finite).then_some("a number that is not finite")
    }

    fn expect_until(&mut self, tick: u64) {
        self.fixes.expect_until(tick);
    }
}

impl<S: CourseStage> CourseSlot<S> {
    /// The next tick has a fix that has not come yet.
    fn waits_for_fix(&self) -> bool {
        let newest_tick = self.queue.back().map_or(0, |state| state.header().tick);
        self.queue.front().is_some_and(|state| !self.fixes.is_ready(state.header(), newest_tick))
    }

    fn read(&mut self, input: &FusedState, mut header: Header, fix: Option<Fix>) -> AttitudeOutput {
        let seen = input.attitude();
        header.flags |= Flags::RESET.when(seen.is_none());
        let attitude = seen.unwrap_or(self.attitude);
        let exchanged = header.flags.any(Flags::EXCHANGED) && header.epoch != self.epoch;
        let reset = input.reset_counter != self.resets[0] || exchanged;
        self.epoch = header.epoch;
        if reset {
            let rotation_rad = Vector3::from(input.rate_rad_s) * header.dt_s();
            let expected = self.attitude.turned(Turn::of_rotation_vector(rotation_rad)).attitude;
            let jump = Turn::between(expected, attitude).quaternion();
            self.jump = [jump.w, jump.i, jump.j, jump.k];
            self.resets[0] = input.reset_counter;
            self.exchanges += u64::from(exchanged);
        }
        self.attitude = attitude;
        let reading = self.stage.step(&CourseInput {
            attitude,
            reference: input.course_reference.into(),
            heading_sd_rad: input.heading_sd_rad,
            fix,
            dt_s: header.dt_s(),
        });
        // Where the attitude was set anew too, it counts once.
        self.resets[1] += u64::from(reading.aligned && !reset);
        header.flags |= Flags::NEAR_GIMBAL.when(reading.near_gimbal) | Flags::ALIGNED.when(reading.aligned);
        let made_true = input.course_reference == CourseReference::MAGNETIC && reading.reference == Reference::True;
        let q = reading.quaternion;
        AttitudeOutput {
            header,
            quaternion: [q.w, q.i, q.j, q.k],
            yaw_rad: reading.angles.yaw_rad,
            pitch_rad: reading.angles.pitch_rad,
            roll_rad: reading.angles.roll_rad,
            course_rad: reading.course_rad,
            course_reference: reading.reference.into(),
            course_sd_rad: reading.course_sd_rad,
            declination_rad: if made_true { self.declination_rad } else { 0.0 },
            rate_rad_s: input.rate_rad_s,
            inclination_sd_rad: input.inclination_sd_rad,
            reset_counter: self.resets.iter().sum::<u64>() + self.exchanges,
            jump: self.jump,
        }
    }
}
