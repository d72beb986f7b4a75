//! Slot `fuser`: fuses `gyro` and `accel`, joined by tick, with `mag` and `gnss` at the ticks that
//! have them.
//!
//! - Input: motion and up direction of each tick; magnetic field and satellite fix of some ticks.
//! - Output: one attitude per tick, on the topic `fused`.
//! - Time: timestamps of the samples.
//! - Failure: missing and unusable input is omitted and flagged. A gap longer than
//!   [`MAX_BRIDGED_GAP_S`] resets the level.

use attitude::{
    accel::Inclination,
    fuser::{Fused, Fuser, FuserInput, FuserStage, innovation_rad},
    gyro::Motion,
    rotation::Rotation,
    state::Attitude,
};
use host::AnyStage;
use launch::Service;
use messages::{AccelPoint, Control, Flags, FusedState, GnssFix, GyroStep, Header, MagSample, Ticked};
use runtime::{
    Join, Joined, MAX_BRIDGED_GAP_S, RuntimeError, Sequence, ServiceConfig, Slot,
    convert::{self, chart_to_payload, complex_to_payload, course_reference_to_payload, finite_vector},
    join::MAX_QUEUED,
    join_inputs,
    stage::{self, ResettingStage},
    state_words::StateWords,
};

/// Longest rate outage after which the attitude is still trusted, s.
const RATE_OUTAGE_LIMIT_S: f64 = 0.2;
/// Minimum tilt error that causes a realignment after an outage, rad (5°). Noise and vehicle
/// manoeuvres stay below it.
const REALIGN_TILT_RAD: f64 = 0.087;

/// Rate above which the body certainly rotates, rad/s (2 °/s). No gyro bias is that large.
const MIN_ROTATION_RATE_RAD_S: f64 = 0.035;

/// Message received on one of the slot's inputs.
#[derive(Debug, Clone, Copy)]
pub enum FuserMessage {
    /// Message of the topic `gyro`.
    Gyro(GyroStep),
    /// Message of the topic `accel`.
    Accel(AccelPoint),
    /// Message of the topic `mag`.
    Mag(MagSample),
    /// Message of the topic `gnss`.
    Gnss(GnssFix),
    /// Message of the topic `control`.
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

join_inputs! {
    /// Inputs of the join, in the order of the slot's inputs.
    Inputs => Tick { gyro: GyroStep, accel: AccelPoint, mag: MagSample, gnss: GnssFix, }
}

/// Slot `fuser`.
#[derive(Debug)]
pub struct FuserSlot {
    join: Join<Inputs>,
    stage: ResettingStage<AnyStage<Fuser>>,
    previous_gyro: Option<(Attitude, i64)>,
    aligned: bool,
    reset_counter: u64,
    /// Duration of the current rate outage, s.
    rate_outage_s: f64,
    attitude: Attitude,
    force_m_s2: [f64; 3],
    /// Set if the body has rotated since the force last changed.
    has_rotated: bool,
}

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built.
pub fn slot(config: &ServiceConfig) -> Result<FuserSlot, RuntimeError> {
    let mut stage = stage::build_stage(Service::Fuser, &config.launch, Fuser::from_name)?;
    if let Some(Err(error)) = config.prior.map(|prior| stage.seed_sensor_errors(&prior.estimate())) {
        eprintln!("service fuser: sensor errors of an earlier run ignored: {error}");
    }
    Ok(FuserSlot {
        join: Join::new(Inputs::default(), config.lateness_ticks()),
        stage: ResettingStage::new(stage),
        previous_gyro: None,
        aligned: false,
        reset_counter: 0,
        rate_outage_s: 0.0,
        attitude: Attitude::default(),
        force_m_s2: [0.0; 3],
        has_rotated: false,
    })
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
        while let Some(tick) = self.join.next() {
            if let Some(state) = self.fuse(&tick) {
                publish(state);
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
        self.stage.failure()
    }

    fn stage(&self) -> &AnyStage<Fuser> {
        &self.stage.stage
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Fuser> {
        &mut self.stage.stage
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.previous_gyro.visit(visit);
        self.aligned.visit(visit);
        self.reset_counter.visit(visit);
        self.rate_outage_s.visit(visit);
        self.attitude.visit(visit);
        self.force_m_s2.visit(visit);
        self.has_rotated.visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        let previous = self.previous_gyro.map_or(Attitude::default(), |(attitude, _)| attitude);
        let are_finite =
            [self.attitude, previous].iter().all(|attitude| attitude.quaternion().coords.norm().is_finite());
        (!are_finite || !self.rate_outage_s.is_finite()).then_some("a number that is not finite")
    }

    fn is_initialised(&self) -> bool {
        self.aligned
    }

    fn expect_backlog(&mut self, tick: u64) {
        self.join.expect_backlog(tick, MAX_QUEUED as u64);
    }
}

impl FuserSlot {
    /// Stops waiting for the input from a slot while that slot has no owner.
    fn on_control(&mut self, control: &Control) {
        let absent_from = if control.owner == 0 { control.from_tick } else { u64::MAX };
        match Service::from_index(control.service) {
            Some(Service::Gyro) => self.join.inputs_mut().gyro.set_absent_from(absent_from),
            Some(Service::Accel) => self.join.inputs_mut().accel.set_absent_from(absent_from),
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
        let Tick { gyro, accel, mag, gnss } = &joined.messages;
        let origin = gyro.as_ref().map(Ticked::header).or(accel.as_ref().map(Ticked::header))?;
        let mut header = self.join.sequence().mark_header(*origin, joined.missing);
        if let Some(accel) = accel {
            header.flags |= accel.header.flags;
        }
        let motion = gyro.as_ref().and_then(|gyro| self.motion(gyro));
        let inclination = accel.as_ref().and_then(|accel| self.inclination(accel, motion.as_ref(), header.flags));
        header.flags |= Flags::GYRO_MISSING.when(motion.is_none()) | Flags::ACCEL_MISSING.when(accel.is_none());
        let over_gap =
            header.flags.any(Flags::GAP | Flags::LOST_BEFORE) && motion.is_some_and(|motion| motion.dt_s == 0.0);
        if over_gap || self.needs_realignment(&header, inclination.as_ref()) {
            self.stage.stage.realign();
        }
        let suspect = Flags::RATE_INVALID | Flags::RATE_STUCK | Flags::FORCE_INVALID | Flags::FORCE_STUCK;
        let rest_credible = !header.flags.any(suspect);
        let rate_credible = !is_rate_unusable(&header);
        let (field_ut, fix) = (mag.as_ref().and_then(convert::field_ut), gnss.as_ref().and_then(convert::fix));
        let missing =
            header.flags.any(Flags::FIELD) && field_ut.is_none() || header.flags.any(Flags::FIX) && fix.is_none();
        header.flags |= Flags::AIDING_MISSING.when(missing);
        let input = FuserInput { motion, inclination, field_ut, fix, rest_credible, rate_credible };
        let fused = self.step(&input, &mut header)?;
        Some(FusedState {
            header,
            w: complex_to_payload(fused.attitude.up.w),
            z_rad: fused.attitude.z_rad,
            chart: chart_to_payload(fused.attitude.up.chart),
            rate_rad_s: fused.rate_rad_s.into(),
            bias_rad_s: fused.bias_rad_s.into(),
            innovation_rad: fused.innovation_rad,
            inclination_sd_rad: fused.inclination_sd_rad,
            heading_sd_rad: fused.heading_sd_rad,
            course_reference: course_reference_to_payload(fused.reference),
            reset_counter: self.reset_counter,
        })
    }

    /// Returns the inclination from an accelerometer message, or `None` if its flags make it
    /// unusable.
    fn inclination(&mut self, accel: &AccelPoint, motion: Option<&Motion>, flags: Flags) -> Option<Inclination> {
        // At rest the force may repeat. If it repeats during a rotation, the accelerometer is dead.
        let is_rotating = motion.is_some_and(|motion| motion.rate_rad_s.norm() > MIN_ROTATION_RATE_RAD_S);
        self.has_rotated = is_rotating || (self.has_rotated && accel.force_m_s2 == self.force_m_s2);
        self.force_m_s2 = accel.force_m_s2;
        let is_dead = flags.any(Flags::FORCE_STUCK) && !flags.any(Flags::RATE_STUCK) && self.has_rotated;
        if is_dead || flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL) {
            return None;
        }
        let force_m_s2 = finite_vector(accel.force_m_s2)?;
        Some(Inclination { up: convert::up(accel)?, force_m_s2, norm_m_s2: accel.norm_m_s2, trust: accel.trust })
    }

    /// Returns `true` on the first usable rate sample after an outage or gap if the tilt error is
    /// too large.
    fn needs_realignment(&mut self, header: &Header, inclination: Option<&Inclination>) -> bool {
        if is_rate_unusable(header) {
            self.rate_outage_s += header.dt_s();
            return false;
        }
        let outage_s = std::mem::take(&mut self.rate_outage_s).max(header.dt_s());
        inclination.is_some_and(|inclination| {
            outage_s > RATE_OUTAGE_LIMIT_S && innovation_rad(inclination, self.attitude) > REALIGN_TILT_RAD
        })
    }

    /// Steps the stage and sets the flags of its output. Returns `None` once the stage has failed.
    fn step(&mut self, input: &FuserInput, header: &mut Header) -> Option<Fused> {
        let (fused, is_reset) = self.stage.step(input)?;
        header.flags |= Flags::RESET.when(is_reset);
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

    /// Returns the motion since the last fused tick.
    ///
    /// If ticks are missing in between, the rotation is computed from the gyro's open-loop
    /// attitudes. Over a gap longer than [`MAX_BRIDGED_GAP_S`], the rotation is the identity and
    /// `dt_s` is 0.
    fn motion(&mut self, gyro: &GyroStep) -> Option<Motion> {
        let header = gyro.header;
        let mut motion = convert::motion(gyro, header.dt_s())?;
        let previous = self.previous_gyro.replace((motion.attitude, header.t_end_ns));
        if let Some((attitude, t_end_ns)) = previous.filter(|(_, t_end_ns)| *t_end_ns != header.t_start_ns) {
            motion.rotation = Rotation::between(attitude, motion.attitude);
            motion.dt_s = (header.t_end_ns - t_end_ns) as f64 * 1e-9;
        }
        if motion.dt_s > MAX_BRIDGED_GAP_S {
            motion.dt_s = 0.0;
            motion.rotation = Rotation::IDENTITY;
        }
        Some(motion)
    }
}

/// Returns `true` if the rate of the tick is invalid, clipped, stuck or missing.
fn is_rate_unusable(header: &Header) -> bool {
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
            max_ticks: None,
            incarnation: 1,
            epoch: 1,
            prior: None,
            resume: None,
            publishes_readings: false,
            supervisor_pid: 0,
        };
        slot(&config).unwrap()
    }

    #[test]
    fn fuser_joins_the_inputs_of_the_graph() {
        let mut joined = Inputs::TOPICS.to_vec();
        let mut inputs: Vec<_> = Service::Fuser.inputs().map(graph::Topic::name).collect();
        joined.sort_unstable();
        inputs.sort_unstable();
        assert_eq!(joined, inputs);
    }

    #[test]
    fn resume_from_unaligned_stage_aligns_the_new_stage() {
        let unaligned = checkpoint::capture(&mut slot_with("wz"), Service::Fuser, 1, false);
        let mut other = slot_with("wz-closed");
        checkpoint::resume(&mut other, Service::Fuser, &unaligned).unwrap();
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
