//! The slot `gyro`: reads `imu` and publishes the motion of each tick on `gyro`.
//!
//! Input: checked IMU samples.
//!
//! Output: the rotation of the body over the tick's interval, and the open-loop attitude.
//!
//! Time: the timestamps of the samples.
//!
//! Failure: missing ticks are bridged with the mean of the adjacent rates, up to
//! [`MAX_BRIDGED_GAP_S`]. Over a longer gap the attitude is held.
#![forbid(unsafe_code)]

use attitude::{
    Vector3,
    accel::MIN_FORCE_M_S2,
    gyro::{Gyro, GyroStage, MAX_BRIDGED_GAP_S, RateKind, RateSample},
    point::Point,
    resetting::ResettingStage,
    state::Attitude,
};
use host::AnyStage;
use launch::{Service, Slot};
use messages::{Flags, GyroStep, Header, ImuSample};
use runtime::{
    RuntimeError, ServiceConfig, ServiceContext, SingleInputSlot, TickProcessor,
    convert::{chart_to_payload, complex_to_payload},
    serve, stage,
    state_words::StateWords,
};

/// Message processor of the slot `gyro`.
#[derive(Debug)]
pub struct GyroProcessor {
    stage: ResettingStage<AnyStage<Gyro>>,
    is_aligned: bool,
    t_end_ns: Option<i64>,
}

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built.
pub fn slot(config: &ServiceConfig) -> Result<SingleInputSlot<GyroProcessor>, RuntimeError> {
    let stage = ResettingStage::new(stage::build_stage(Slot::Gyro, &config.launch, Gyro::from_name)?);
    Ok(SingleInputSlot::new(GyroProcessor { stage, is_aligned: false, t_end_ns: None }))
}

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the service cannot join the system, build its stage or continue.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Gyro)?;
    let slot = slot(&context.config)?;
    let imu = context.subscriber::<ImuSample>()?;
    serve(context, slot, &[&imu])
}

impl GyroProcessor {
    /// Aligns the open-loop attitude with the first force that has a direction.
    fn align_level(&mut self, input: &ImuSample) -> Option<Attitude> {
        let force_m_s2 = Vector3::from(input.force_m_s2);
        let usable = !input.header.flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL);
        let up = Point::from_direction(force_m_s2).filter(|_| usable && force_m_s2.norm() >= MIN_FORCE_M_S2)?;
        let level = Attitude::from_up(up);
        self.stage.stage.align(level);
        self.is_aligned = true;
        Some(level)
    }
}

impl TickProcessor for GyroProcessor {
    const SLOT: Slot = Slot::Gyro;

    type Input = ImuSample;
    type Output = GyroStep;
    type Stage = AnyStage<Gyro>;

    fn process(&mut self, input: &ImuSample, mut header: Header) -> Option<GyroStep> {
        let previous_ns = self.t_end_ns.replace(header.t_end_ns).unwrap_or(header.t_start_ns);
        let dt_s = (header.t_end_ns - previous_ns) as f64 * 1e-9;
        let kind = if header.flags.any(Flags::RATE_INSTANT) { RateKind::Instant } else { RateKind::Mean };
        let dt_s = if dt_s <= MAX_BRIDGED_GAP_S { dt_s } else { 0.0 };
        let (mut motion, was_reset) =
            self.stage.step(&RateSample { rate_rad_s: input.rate_rad_s.into(), dt_s, kind })?;
        header.flags |= Flags::RESET.when(was_reset);
        if !self.is_aligned {
            motion.attitude = self.align_level(input).unwrap_or(motion.attitude);
        }
        Some(GyroStep {
            header,
            w: complex_to_payload(motion.attitude.up.w),
            z_rad: motion.attitude.z_rad,
            chart: chart_to_payload(motion.attitude.up.chart),
            p: complex_to_payload(motion.rotation.p),
            s: complex_to_payload(motion.rotation.s),
            rate_rad_s: motion.rate_rad_s.into(),
        })
    }

    fn resetting_stage(&self) -> &ResettingStage<AnyStage<Gyro>> {
        &self.stage
    }

    fn resetting_stage_mut(&mut self) -> &mut ResettingStage<AnyStage<Gyro>> {
        &mut self.stage
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.is_aligned.visit(visit);
        self.t_end_ns.visit(visit);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use bytemuck::Zeroable;
    use launch::Launch;
    use messages::Checkpoint;
    use runtime::{Pace, Role, service_config::Resume, slot_service::SlotService};

    use super::*;

    fn service(stage: &str, role: Role, from: Option<&Checkpoint>) -> SlotService<SingleInputSlot<GyroProcessor>> {
        service_from_tick(stage, role, from, 0)
    }

    /// Creates a service for a slot that has already published its output before `output_tick`.
    fn service_from_tick(
        stage: &str,
        role: Role,
        from: Option<&Checkpoint>,
        output_tick: u64,
    ) -> SlotService<SingleInputSlot<GyroProcessor>> {
        let mut launch = Launch::default();
        launch.gyro.stage = stage.into();
        let resume = from.map(|checkpoint| Resume::Checkpoint(Box::new(*checkpoint)));
        let config =
            ServiceConfig { incarnation: 1, role, resume, ..ServiceConfig::standalone(launch, 1000.0, Pace::Max) };
        let (service, rejected) = SlotService::new(slot(&config).unwrap(), &config, 0, output_tick);
        assert_eq!(rejected, None);
        service
    }

    /// Returns each published tick with its `SWAPPED` flag, which marks the first output of a new
    /// stage.
    fn output_swapped_flags(
        service: &mut SlotService<SingleInputSlot<GyroProcessor>>,
        ticks: std::ops::Range<u64>,
    ) -> Vec<(u64, bool)> {
        output_flags(service, ticks, Flags::SWAPPED)
    }

    /// Returns each published tick, and `true` if it has `flag`.
    fn output_flags(
        service: &mut SlotService<SingleInputSlot<GyroProcessor>>,
        ticks: std::ops::Range<u64>,
        flag: Flags,
    ) -> Vec<(u64, bool)> {
        let mut published = Vec::new();
        for tick in ticks {
            let (t_start_ns, t_end_ns) = (tick as i64 * 1_000_000, (tick as i64 + 1) * 1_000_000);
            let mut sample =
                ImuSample { force_m_s2: [0.0, 0.0, 9.8], rate_rad_s: [0.1, 0.2, 0.3], ..ImuSample::zeroed() };
            sample.header = Header { tick, t_start_ns, t_end_ns, ..Header::zeroed() };
            service.offer(sample, &mut |_| {}, &mut |step| {
                published.push((step.header.tick, step.header.flags.any(flag)));
            });
        }
        published
    }

    #[test]
    fn first_output_after_restart_keeps_swapped_flag() {
        let mut former = service("mobius", Role::Owner { from_tick: 0 }, None);
        output_swapped_flags(&mut former, 0..50);
        let state = former.checkpoint().unwrap();
        for (stage, swapped) in [("rk4", true), ("mobius", false)] {
            let mut candidate = service(stage, Role::Candidate, Some(&state));
            assert_eq!(output_swapped_flags(&mut candidate, 50..60), []);
            let state = candidate.checkpoint().unwrap();
            let mut owner = service(stage, Role::Owner { from_tick: 70 }, Some(&state));
            let expected: Vec<_> = (70..80).map(|tick| (tick, swapped && tick == 70)).collect();
            assert_eq!(output_swapped_flags(&mut owner, 60..80), expected, "{stage}");
        }
    }
    #[test]
    fn missing_inputs_flag_first_new_output() {
        let mut former = service("mobius", Role::Owner { from_tick: 0 }, None);
        output_swapped_flags(&mut former, 0..50);
        let state = former.checkpoint().unwrap();
        for (first, has_loss) in [(50, false), (55, true)] {
            let mut owner = service_from_tick("mobius", Role::Owner { from_tick: 0 }, Some(&state), 60);
            output_flags(&mut owner, first..60, Flags::LOST_BEFORE);
            let expected: Vec<_> = (60..70).map(|tick| (tick, has_loss && tick == 60)).collect();
            assert_eq!(output_flags(&mut owner, 60..70, Flags::LOST_BEFORE), expected);
        }
    }
}
