//! The slot `gyro`: reads `imu` and publishes the motion of each tick on `gyro`.
//!
//! Input: checked IMU samples.
//!
//! Output: the rotation of the body over the tick's interval, and the open-loop attitude.
//!
//! Time: the timestamps of the samples.
//!
//! Failure: see [`attitude::gyro::supervised`].

use attitude::{
    gyro::{Gyro, SupervisedGyro, supervised::GyroTick},
    state_words::StateWords,
    validated_stage::ValidatedStage,
};
use host::AnyStage;
use launch::Slot;
use messages::{Flags, GyroStep, Header, ImuSample};
use runtime::{
    RuntimeError, ServiceConfig, SingleInputSlot, TickProcessor,
    convert::{chart_to_payload, complex_to_payload},
    stage,
};

/// Message processor of the slot `gyro`.
#[derive(Debug)]
pub struct GyroProcessor(SupervisedGyro<AnyStage<Gyro>>);

/// Creates the slot with the stage that `config` names.
///
/// # Errors
///
/// Returns an error if the stage cannot be built.
pub fn slot(config: &ServiceConfig) -> Result<SingleInputSlot<GyroProcessor>, RuntimeError> {
    let gyro = SupervisedGyro::new(stage::build_stage(Slot::Gyro, &config.launch, Gyro::from_name)?);
    Ok(SingleInputSlot::new(GyroProcessor(gyro)))
}

impl TickProcessor for GyroProcessor {
    const SLOT: Slot = Slot::Gyro;

    type Input = ImuSample;
    type Output = GyroStep;
    type Stage = AnyStage<Gyro>;

    fn process(&mut self, input: &ImuSample, mut header: Header) -> Option<GyroStep> {
        let Header { t_start_ns, t_end_ns, flags, .. } = header;
        let ImuSample { rate_rad_s, force_m_s2, .. } = *input;
        let (motion, was_reset) = self.0.step(&GyroTick { t_start_ns, t_end_ns, flags, rate_rad_s, force_m_s2 })?;
        header.flags |= Flags::RESET.when(was_reset);
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

    fn validated_stage(&self) -> &ValidatedStage<AnyStage<Gyro>> {
        &self.0.validated
    }

    fn validated_stage_mut(&mut self) -> &mut ValidatedStage<AnyStage<Gyro>> {
        &mut self.0.validated
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.0.state_mut().visit(visit);
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

    /// Returns each published tick with its `SWAPPED` flag. The flag marks the first output of a
    /// new stage.
    fn output_swapped_flags(
        service: &mut SlotService<SingleInputSlot<GyroProcessor>>,
        ticks: std::ops::Range<u64>,
    ) -> Vec<(u64, bool)> {
        output_flags(service, ticks, Flags::SWAPPED)
    }

    /// Returns each published tick and whether it has `flag`.
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
        let state = *former.checkpoint().unwrap().unwrap();
        for (stage, swapped) in [("rk4", true), ("mobius", false)] {
            let mut candidate = service(stage, Role::Candidate, Some(&state));
            assert_eq!(output_swapped_flags(&mut candidate, 50..60), []);
            let state = *candidate.checkpoint().unwrap().unwrap();
            let mut owner = service(stage, Role::Owner { from_tick: 70 }, Some(&state));
            let expected: Vec<_> = (70..80).map(|tick| (tick, swapped && tick == 70)).collect();
            assert_eq!(output_swapped_flags(&mut owner, 60..80), expected, "{stage}");
        }
    }
    #[test]
    fn missing_inputs_flag_first_new_output() {
        let mut former = service("mobius", Role::Owner { from_tick: 0 }, None);
        output_swapped_flags(&mut former, 0..50);
        let state = *former.checkpoint().unwrap().unwrap();
        for (first, has_loss) in [(50, false), (55, true)] {
            let mut owner = service_from_tick("mobius", Role::Owner { from_tick: 0 }, Some(&state), 60);
            output_flags(&mut owner, first..60, Flags::LOST_BEFORE);
            let expected: Vec<_> = (60..70).map(|tick| (tick, has_loss && tick == 60)).collect();
            assert_eq!(output_flags(&mut owner, 60..70, Flags::LOST_BEFORE), expected);
        }
    }
}
