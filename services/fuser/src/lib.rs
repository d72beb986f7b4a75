//! The slot `fuser`: from `gyro` and `accel`, joined by tick, with `mag` and `gnss` where a tick has them, to `fused`.
//!
//! Input: the motion and the point of each tick, a field and a fix of some. Output: one attitude for each tick. Time: the samples' own. Failure: what is
//! missing or cannot be used is left out and flagged; over a gap longer than the gyro bridges the level is set anew.
#![forbid(unsafe_code)]

use attitude::{
    accel::Inclination,
    fuser::{Fused, Fuser, FuserInput, FuserStage, innovation_rad},
    gyro::Motion,
    state::Attitude,
    turn::Turn,
};
use host::AnyStage;
use launch::Service;
use messages::{AccelPoint, Control, Flags, FusedState, GnssFix, GyroStep, Header, MagSample, Ticked};
use runtime::{
    BRIDGE_S, Join, Joined, RuntimeError, Sequence, ServiceConfig, ServiceContext, Slot,
    join::QUEUE_MAX,
    lanes,
    quantities::{self, chart_of, course_reference_of, finite, pair},
    serve,
    stage::{self, Filled},
    state_words::Words,
};

/// A time without a rate after which the attitude may be anywhere, s.
const BLIND_S: f64 = 0.2;
/// A distance between the accelerometer's up and the attitude's that noise and manoeuvres of a vehicle do not make, rad: 5°.
const ASTRAY_RAD: f64 = 0.087;

/// A rate that no bias of a gyro is, rad/s: 2 °/s.
const TURN_RAD_S: f64 = 0.035;

/// What the slot reads.
#[derive(Debug, Clone, Copy)]
pub enum FuserMessage {
    /// Of the topic `gyro`.
    Gyro(GyroStep),
    /// Of the topic `accel`.
    Accel(AccelPoint),
    /// Of the topic `mag`.
    Mag(MagSample),
    /// Of the topic `gnss`.
    Gnss(GnssFix),
    /// Of the topic `control`.
    Control(Control),
}

impl From<Control> for FuserMessage {
    fn from(message: Control) -> Self {
        Self::Control(message)
    }
}

impl From<GyroStep> for FuserMessage {
    fn from(message: GyroStep) -> Self {
        Self::Gyro(message)
    }
}

impl From<AccelPoint> for FuserMessage {
    fn from(message: AccelPoint) -> Self {
        Self::Accel(message)
    }
}

impl From<MagSample> for FuserMessage {
    fn from(message: MagSample) -> Self {
        Self::Mag(message)
    }
}

impl From<GnssFix> for FuserMessage {
    fn from(message: GnssFix) -> Self {
        Self::Gnss(message)
    }
}

lanes! {
    /// What the slot joins, in the order in which it is read.
    Inputs => Tick { gyro: GyroStep, accel: AccelPoint, mag: MagSample, gnss: GnssFix, }
}

/// The slot.
#[derive(Debug)]
pub struct FuserSlot {
    join: Join<Inputs>,
    filled: Filled<AnyStage<Fuser>>,
    gyro_before: Option<(Attitude, i64)>,
    aligned: bool,
    reset_counter: u64,
    /// For how long the rate was not one, s.
    blind_s: f64,
    attitude: Attitude,
    force_m_s2: [f64; 3],
    /// The body has turned since the force last changed.
    turned: bool,
}

/// The slot with the stage that `config` names.
pub fn slot(config: &ServiceConfig) -> Result<FuserSlot, RuntimeError> {
    let mut stage = stage::chosen(Service::Fuser, &config.launch, Fuser::named)?;
    if let Some(Err(error)) = config.prior.map(|prior| stage.begin_with(&prior.estimate())) {
        eprintln!("the service fuser begins without what an earlier run has found: {error}");
    }
    Ok(FuserSlot {
        join: Join::new(Inputs::default(), config.lateness_ticks()),
        filled: Filled::new(stage),
        gyro_before: None,
        aligned: false,
        reset_counter: 0,
        blind_s: 0.0,
        attitude: Attitude::default(),
        force_m_s2: [0.0; 3],
        turned: false,
    })
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Fuser)?;
    let slot = slot(&context.config)?;
    let (gyro, accel) = (context.reader::<GyroStep>()?, context.reader::<AccelPoint>()?);
    let (mag, gnss) = (context.subscriber::<MagSample>()?, context.subscriber::<GnssFix>()?);
    let control = context.control()?;
    serve(context, slot, &[&gyro, &accel, &mag, &gnss, &control])
}

impl Slot for FuserSlot {
    type Input = FuserMessage;
    type Output = FusedState;
    type Stage = AnyStage<Fuser>;

    fn offer(&mut self, input: FuserMessage, publish: &mut dyn FnMut(FusedState)) {
        match input {
            FuserMessage::Gyro(message) => self.join.offer(|inputs| Some(&mut inputs.gyro), message),
            FuserMessage::Accel(message) => self.join.offer(|inputs| Some(&mut inputs.accel), message),
            FuserMessage::Mag(message) => self.join.offer(|inputs| Some(&mut inputs.mag), message),
            FuserMessage::Gnss(message) => self.join.offer(|inputs| Some(&mut inputs.gnss), message),
            FuserMessage::Control(message) => self.on_control(&message),
        }
        while let Some(tick) = self.join.take() {
            if let Some(state) = self.fuse(&tick) {
                publish(state);
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

    fn stage(&self) -> &AnyStage<Fuser> {
        &self.filled.stage
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Fuser> {
        &mut self.filled.stage
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.gyro_before.visit(visit);
        self.aligned.visit(visit);
        self.reset_counter.visit(visit);
        self.blind_s.visit(visit);
        self.attitude.visit(visit);
        self.force_m_s2.visit(visit);
        self.turned.visit(visit);
    }

    fn own_flaw(&self) -> Option<&'static str> {
        let before = self.gyro_before.map_or(Attitude::default(), |(attitude, _)| attitude);
        let attitudes = [self.attitude, before].iter().all(|attitude| attitude.quaternion().coords.norm().is_finite());
        (!attitudes || !self.blind_s.is_finite()).then_some("a number that is not finite")
    }

    fn has_begun(&self) -> bool {
        self.aligned
    }

    fn expect_until(&mut self, tick: u64) {
        self.join.expect_until(tick, QUEUE_MAX as u64);
    }
}

impl FuserSlot {
    /// A slot that nobody owns any more is not waited for, until somebody owns it again.
    fn on_control(&mut self, control: &Control) {
        let absent_from = if control.owner == 0 { control.from_tick } else { u64::MAX };
        match Service::at(control.service) {
            Some(Service::Gyro) => self.join.lanes_mut().gyro.is_absent_from(absent_from),
            Some(Service::Accel) => self.join.lanes_mut().accel.is_absent_from(absent_from),
            Some(
                Service::Ingest
                | Service::Fuser
                | Service::Course
                | Service::Gateway
                | Service::Drivers
                | Service::Cockpit,
            )
            | None => {}
        }
    }

    fn fuse(&mut self, joined: &Joined<Tick>) -> Option<FusedState> {
        let Tick { gyro, accel, mag, gnss } = &joined.parts;
        let origin = gyro.as_ref().map(Ticked::header).or(accel.as_ref().map(Ticked::header))?;
        let mut header = self.join.sequence().mark(*origin, joined.missing);
        if let Some(accel) = accel {
            header.flags |= accel.header.flags;
        }
        let motion = gyro.as_ref().and_then(|gyro| self.motion(gyro));
        let inclination = accel.as_ref().and_then(|accel| self.inclination(accel, motion.as_ref(), header.flags));
        header.flags |= Flags::GYRO_MISSING.when(motion.is_none()) | Flags::ACCEL_MISSING.when(accel.is_none());
        let over_gap =
            header.flags.any(Flags::GAP | Flags::LOST_BEFORE) && motion.is_some_and(|motion| motion.dt_s == 0.0);
        if over_gap || self.is_astray(&header, inclination.as_ref()) {
            self.filled.stage.realign();
        }
        let suspect = Flags::RATE_INVALID | Flags::RATE_STUCK | Flags::FORCE_INVALID | Flags::FORCE_STUCK;
        let rest_credible = !header.flags.any(suspect);
        let rate_credible = !is_blind(&header);
        let (field_ut, fix) = (mag.as_ref().and_then(quantities::field_ut), gnss.as_ref().and_then(quantities::fix));
        let missing =
            header.flags.any(Flags::FIELD) && field_ut.is_none() || header.flags.any(Flags::FIX) && fix.is_none();
        header.flags |= Flags::AIDING_MISSING.when(missing);
        let input = FuserInput { motion, inclination, field_ut, fix, rest_credible, rate_credible };
        let fused = self.step(&input, &mut header)?;
        Some(FusedState {
            header,
            w: pair(fused.attitude.up.w),
            z_rad: fused.attitude.z_rad,
            chart: chart_of(fused.attitude.up.chart),
            rate_rad_s: fused.rate_rad_s.into(),
            bias_rad_s: fused.bias_rad_s.into(),
            innovation_rad: fused.innovation_rad,
            inclination_sd_rad: fused.inclination_sd_rad,
            heading_sd_rad: fused.heading_sd_rad,
            course_reference: course_reference_of(fused.reference),
            reset_counter: self.reset_counter,
        })
    }

    /// The inclination of a point, unless its flags say that it is not one.
    fn inclination(&mut self, accel: &AccelPoint, motion: Option<&Motion>, flags: Flags) -> Option<Inclination> {
        // A body at rest repeats its force; one that turns and repeats it has a dead accelerometer.
        let turns = motion.is_some_and(|motion| motion.rate_rad_s.norm() > TURN_RAD_S);
        self.turned = turns || (self.turned && accel.force_m_s2 == self.force_m_s2);
        self.force_m_s2 = accel.force_m_s2;
        let dead = flags.any(Flags::FORCE_STUCK) && !flags.any(Flags::RATE_STUCK) && self.turned;
        if dead || flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL) {
            return None;
        }
        let force_m_s2 = finite(accel.force_m_s2)?;
        Some(Inclination { up: quantities::up(accel)?, force_m_s2, norm_m_s2: accel.norm_m_s2, trust: accel.trust })
    }

    /// The gyro is back after a time without a rate, or after a gap, and the body has turned away from what the attitude followed.
    fn is_astray(&mut self, header: &Header, inclination: Option<&Inclination>) -> bool {
        if is_blind(header) {
            self.blind_s += header.dt_s();
            return false;
        }
        let blind_s = std::mem::take(&mut self.blind_s).max(header.dt_s());
        inclination
            .is_some_and(|inclination| blind_s > BLIND_S && innovation_rad(inclination, self.attitude) > ASTRAY_RAD)
    }

    /// One step of the stage; `None` where it cannot go on.
    fn step(&mut self, input: &FuserInput, header: &mut Header) -> Option<Fused> {
        let (fused, anew) = self.filled.step(input)?;
        header.flags |= Flags::RESET.when(anew);
        self.attitude = fused.attitude;
        let aligned_now = fused.corrections.aligned;
        self.reset_counter += u64::from(self.aligned && (aligned_now || header.flags.any(Flags::RESET)));
        self.aligned |= aligned_now;
        header.flags |= Flags::ALIGNED.when(aligned_now)
            | Flags::UNALIGNED.when(!self.aligned)
            | Flags::AT_REST.when(fused.corrections.rest)
            | Flags::FIELD_DISTURBED.when(fused.corrections.disturbed);
        Some(fused)
    }

    /// The motion since the last tick that was fused. Where ticks are missing on the way here, the gyro's own attitude still knows
    /// how far the body turned.
    fn motion(&mut self, gyro: &GyroStep) -> Option<Motion> {
        let header = gyro.header;
        let mut motion = quantities::motion(gyro, header.dt_s())?;
        let before = self.gyro_before.replace((motion.attitude, header.t_end_ns));
        if let Some((attitude, t_end_ns)) = before.filter(|(_, t_end_ns)| *t_end_ns != header.t_start_ns) {
            motion.turn = Turn::between(attitude, motion.attitude);
            motion.dt_s = (header.t_end_ns - t_end_ns) as f64 * 1e-9;
        }
        if motion.dt_s > BRIDGE_S {
            motion.dt_s = 0.0;
            motion.turn = Turn::NONE;
        }
        Some(motion)
    }
}

/// The motion is not what the body did.
fn is_blind(header: &Header) -> bool {
    header.flags.any(Flags::RATE_INVALID | Flags::RATE_CLIPPED | Flags::RATE_STUCK | Flags::GYRO_MISSING)
}

#[cfg(test)]
mod tests {
    use attitude::Complex;
    use launch::Launch;
    use runtime::{Pace, Role, checkpoint};

    use super::*;

    fn slot_with(stage: &str) -> FuserSlot {
        let mut launch = Launch::default();
        launch.fuser.stage = stage.into();
        let (rate_hz, pace, role) = (100.0, Pace::Max, Role::Owner { from_tick: 0 });
        let config = ServiceConfig {
            launch,
            rate_hz,
            pace,
            role,
            ticks_max: None,
            incarnation: 1,
            epoch: 1,
            prior: None,
            resume: None,
            readings: false,
            supervisor_pid: 0,
        };
        slot(&config).unwrap()
    }

    #[test]
    fn the_slot_joins_the_inputs_that_the_graph_gives_it() {
        let mut joined = Inputs::TOPICS.to_vec();
        let mut inputs: Vec<_> = Service::Fuser.inputs().map(graph::Topic::name).collect();
        joined.sort_unstable();
        inputs.sort_unstable();
        assert_eq!(joined, inputs);
    }

    #[test]
    fn who_goes_on_from_a_stage_that_was_never_level_sets_the_level_itself() {
        let nothing_yet = checkpoint::checkpoint(&mut slot_with("wz"), Service::Fuser, 1, false);
        let mut other = slot_with("wz-closed");
        checkpoint::resume(&mut other, Service::Fuser, &nothing_yet).unwrap();
        let mut level = AccelPoint { w: [0.3, 0.1], norm_m_s2: 9.8, trust: 1.0, ..bytemuck::Zeroable::zeroed() };
        level.force_m_s2 =
            attitude::point::Point { w: Complex::new(0.3, 0.1), ..Default::default() }.direction().into();
        let still = GyroStep { p: [1.0, 0.0], ..bytemuck::Zeroable::zeroed() };
        let mut outputs = Vec::new();
        other.offer(level.into(), &mut |out| outputs.push(out));
        other.offer(still.into(), &mut |out| outputs.push(out));
        assert_eq!(outputs[0].w.map(|x| (x * 1e9).round() / 1e9), [0.3, 0.1]);
        assert!(outputs[0].header.flags.any(Flags::ALIGNED));
    }
}
