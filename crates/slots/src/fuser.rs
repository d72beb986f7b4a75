//! Slot `fuser`: fuses `gyro` and `accel`, joined by tick, with `mag` and `gnss` at the ticks that
//! have them.
//!
//! - Input: motion and up direction of each tick; magnetic field and satellite fix of some ticks.
//! - Output: one attitude per tick, on the topic `fused`.
//! - Time: timestamps of the samples.
//! - Failure: missing and unusable input is flagged. [`SupervisedFuser`] decides which input is
//!   used and when the level is reset.

use attitude::{
    accel::Inclination,
    fuser::{
        Fuser, FuserStage, SupervisedFuser,
        supervised::{SensorTick, SupervisedFused},
    },
    state_words::StateWords,
};
use host::AnyStage;
use launch::{Service, Slot};
use messages::{AccelPoint, Control, Flags, FusedState, GnssFix, GyroStep, MagSample, Ticked};
use runtime::{
    Join, Joined, RuntimeError, Sequence, ServiceConfig, ServiceContext, SlotInputs, SlotProcessor,
    convert::{self, chart_to_payload, complex_to_payload, course_reference_to_payload, finite_vector},
    join::MAX_QUEUED,
    join_inputs, slot_messages, stage,
};

slot_messages! {
    FuserMessage { Gyro(GyroStep), Accel(AccelPoint), Mag(MagSample), Gnss(GnssFix), Control(Control), }
}

join_inputs! {
    /// Inputs of the join, in the order of the slot's inputs.
    Inputs => Tick { gyro: GyroStep, accel: AccelPoint, mag: MagSample, gnss: GnssFix, }
}

/// Slot `fuser`.
#[derive(Debug)]
pub struct FuserSlot {
    join: Join<Inputs>,
    fuser: SupervisedFuser<AnyStage<Fuser>>,
}

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built.
pub fn slot(config: &ServiceConfig) -> Result<FuserSlot, RuntimeError> {
    let mut stage = stage::build_stage(Slot::Fuser, &config.launch, Fuser::from_name)?;
    if let Some(Err(error)) = config.prior.map(|prior| stage.seed_sensor_errors(&prior.estimate())) {
        eprintln!("service fuser: sensor errors of an earlier run ignored: {error}");
    }
    let join = Join::new(Inputs::default(), config.lateness_ticks());
    Ok(FuserSlot { join, fuser: SupervisedFuser::new(stage) })
}

/// Subscribes to the inputs of the slot.
///
/// # Errors
///
/// Returns an error if the bus fails.
pub fn subscribe(context: &ServiceContext) -> Result<SlotInputs<FuserMessage>, RuntimeError> {
    Ok(vec![
        Box::new(context.ordered_subscriber::<GyroStep>()?),
        Box::new(context.ordered_subscriber::<AccelPoint>()?),
        Box::new(context.subscriber::<MagSample>()?),
        Box::new(context.subscriber::<GnssFix>()?),
        Box::new(context.control()?),
    ])
}

impl SlotProcessor for FuserSlot {
    const SLOT: Slot = Slot::Fuser;

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

    fn has_incomplete_tick(&self) -> bool {
        self.join.has_incomplete_tick()
    }

    fn failure(&self) -> Option<String> {
        self.fuser.failure().map(|failure| failure.to_string())
    }

    fn stage(&self) -> &AnyStage<Fuser> {
        self.fuser.stage()
    }

    fn stage_mut(&mut self) -> &mut AnyStage<Fuser> {
        self.fuser.stage_mut()
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.join.sequence_mut().visit(visit);
        self.fuser.state_mut().visit(visit);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.fuser.state().validation_error()
    }

    fn is_initialised(&self) -> bool {
        self.fuser.state().is_aligned
    }

    fn expect_backlog(&mut self, tick: u64) {
        self.join.expect_backlog(tick, MAX_QUEUED as u64);
    }
}

impl FuserSlot {
    /// Stops waiting for the input from a slot while that slot has no owner.
    fn on_control(&mut self, control: &Control) {
        let absent_from = if control.owner == 0 { control.from_tick } else { u64::MAX };
        match Service::from_index(control.service).and_then(Service::slot) {
            Some(Slot::Gyro) => self.join.inputs_mut().gyro.set_absent_from(absent_from),
            Some(Slot::Accel) => self.join.inputs_mut().accel.set_absent_from(absent_from),
            Some(Slot::Fuser | Slot::Course) | None => {}
        }
    }

    /// Fuses the messages of a tick. Returns `None` once the stage has failed.
    fn fuse(&mut self, joined: &Joined<Tick>) -> Option<FusedState> {
        let Tick { gyro, accel, mag, gnss } = &joined.messages;
        let origin = gyro.as_ref().map(Ticked::header).or(accel.as_ref().map(Ticked::header))?;
        let mut header = self.join.sequence().mark_header(*origin, joined.missing);
        if let Some(accel) = accel {
            header.flags |= accel.header.flags;
        }
        let tick = SensorTick {
            motion: gyro.as_ref().and_then(|gyro| convert::motion(gyro, header.dt_s())),
            force_m_s2: accel.as_ref().map(|accel| accel.force_m_s2.into()),
            inclination: accel.as_ref().and_then(inclination),
            field_ut: mag.as_ref().and_then(convert::field_ut),
            fix: gnss.as_ref().and_then(convert::fix),
            ..SensorTick::from_flags(header.t_start_ns, header.t_end_ns, header.flags)
        };
        let is_aiding_missing = header.flags.any(Flags::FIELD) && tick.field_ut.is_none()
            || header.flags.any(Flags::FIX) && tick.fix.is_none();
        let output = self.fuser.step(&tick)?;
        header.flags |= Flags::GYRO_MISSING.when(tick.motion.is_none())
            | Flags::ACCEL_MISSING.when(accel.is_none())
            | Flags::AIDING_MISSING.when(is_aiding_missing)
            | output.flags();
        let SupervisedFused { fused, reset_counter, .. } = output;
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
            reset_counter,
        })
    }
}

/// Returns the inclination, or `None` if a value is not finite or the chart is unknown.
fn inclination(accel: &AccelPoint) -> Option<Inclination> {
    let force_m_s2 = finite_vector(accel.force_m_s2)?;
    Some(Inclination { up: convert::up(accel)?, force_m_s2, norm_m_s2: accel.norm_m_s2, trust: accel.trust })
}

#[cfg(test)]
mod tests {
    use attitude::Complex;
    use launch::Launch;
    use runtime::{Pace, checkpoint};

    use super::*;

    fn slot_with(stage: &str) -> FuserSlot {
        let mut launch = Launch::default();
        launch.fuser.stage = stage.into();
        let config = ServiceConfig::standalone(launch, 100.0, Pace::Max);
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
        let mut unaligned = bytemuck::Zeroable::zeroed();
        checkpoint::capture(&mut slot_with("wz"), 1, false, &mut unaligned);
        let mut other = slot_with("wz-closed");
        checkpoint::resume(&mut other, &unaligned).unwrap();
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
