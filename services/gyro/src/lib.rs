//! The slot `gyro`: from `imu` to `gyro`, the motion of each tick.
//!
//! Input: checked IMU samples. Output: the step's turn and the open-loop attitude. Time: the samples' own. Failure: ticks that never
//! came are bridged by the mean of the rates around them, no longer than [`BRIDGE_S`]; over a longer gap the attitude is held.
#![forbid(unsafe_code)]

use attitude::{
    Vector3,
    accel::FORCE_MIN_M_S2,
    gyro::{Gyro, GyroStage, RateKind, RateSample},
    point::Point,
    state::Attitude,
};
use host::AnyStage;
use launch::Service;
use messages::{Flags, GyroStep, Header, ImuSample};
use runtime::{
    BRIDGE_S, EachTick, RuntimeError, ServiceConfig, ServiceContext, Work,
    quantities::{chart_of, pair},
    serve,
    stage::{self, Filled},
    state_words::Words,
};

/// The work of the slot.
#[derive(Debug)]
pub struct GyroWork {
    filled: Filled<AnyStage<Gyro>>,
    aligned: bool,
    t_end_ns: Option<i64>,
}

/// The slot with the stage that `config` names.
pub fn slot(config: &ServiceConfig) -> Result<EachTick<GyroWork>, RuntimeError> {
    let filled = Filled::new(stage::chosen(Service::Gyro, &config.launch, Gyro::named)?);
    Ok(EachTick::new(GyroWork { filled, aligned: false, t_end_ns: None }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Gyro)?;
    let slot = slot(&context.config)?;
    let imu = context.subscriber::<ImuSample>()?;
    serve(context, slot, &[&imu])
}

impl GyroWork {
    /// The open-loop attitude starts level with the first force that has a direction.
    fn align(&mut self, input: &ImuSample) -> Option<Attitude> {
        let force_m_s2 = Vector3::from(input.force_m_s2);
        let usable = !input.header.flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL);
        let up = Point::of(force_m_s2).filter(|_| usable && force_m_s2.norm() >= FORCE_MIN_M_S2)?;
        let level = Attitude::levelled(up);
        self.filled.stage.align(level);
        self.aligned = true;
        Some(level)
    }
}

impl Work for GyroWork {
    type Input = ImuSample;
    type Output = GyroStep;
    type Stage = AnyStage<Gyro>;

    fn work(&mut self, input: &ImuSample, mut header: Header) -> Option<GyroStep> {
        let before_ns = self.t_end_ns.replace(header.t_end_ns).unwrap_or(header.t_start_ns);
        let dt_s = (header.t_end_ns - before_ns) as f64 * 1e-9;
        let kind = if header.flags.any(Flags::RATE_INSTANT) { RateKind::Instant } else { RateKind::Mean };
        let dt_s = if dt_s <= BRIDGE_S { dt_s } else { 0.0 };
        let (mut motion, anew) = self.filled.step(&RateSample { rate_rad_s: input.rate_rad_s.into(), dt_s, kind })?;
        header.flags |= Flags::RESET.when(anew);
        if !self.aligned {
            motion.attitude = self.align(input).unwrap_or(motion.attitude);
        }
        Some(GyroStep {
            header,
            w: pair(motion.attitude.up.w),
            z_rad: motion.attitude.z_rad,
            chart: chart_of(motion.attitude.up.chart),
            p: pair(motion.turn.p),
            s: pair(motion.turn.s),
            rate_rad_s: motion.rate_rad_s.into(),
        })
    }

    fn filled(&self) -> &Filled<AnyStage<Gyro>> {
        &self.filled
    }

    fn filled_mut(&mut self) -> &mut Filled<AnyStage<Gyro>> {
        &mut self.filled
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.aligned.visit(visit);
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

    fn service(stage: &str, role: Role, from: Option<&Checkpoint>) -> SlotService<EachTick<GyroWork>> {
        service_at(stage, role, from, 0)
    }

    /// One of a slot that has published what comes before `output_tick`.
    fn service_at(
        stage: &str,
        role: Role,
        from: Option<&Checkpoint>,
        output_tick: u64,
    ) -> SlotService<EachTick<GyroWork>> {
        let mut launch = Launch::default();
        launch.gyro.stage = stage.into();
        let resume = from.map(|checkpoint| Resume::Checkpoint(Box::new(checkpoint.into())));
        let config = ServiceConfig {
            launch,
            rate_hz: 1000.0,
            pace: Pace::Max,
            ticks_max: None,
            incarnation: 1,
            epoch: 1,
            role,
            prior: None,
            resume,
            readings: false,
            supervisor_pid: 0,
        };
        let (service, refused) = SlotService::new(slot(&config).unwrap(), Service::Gyro, &config, 0, output_tick);
        assert_eq!(refused, None);
        service
    }

    /// The ticks that are published, each with whether it says that another stage than before has made it.
    fn published(service: &mut SlotService<EachTick<GyroWork>>, ticks: std::ops::Range<u64>) -> Vec<(u64, bool)> {
        flagged(service, ticks, Flags::SWAPPED)
    }

    /// The ticks that are published, each with whether it has the flag.
    fn flagged(
        service: &mut SlotService<EachTick<GyroWork>>,
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
    fn a_stage_that_dies_before_its_first_output_still_says_there_that_it_is_another() {
        let mut former = service("mobius", Role::Owner { from_tick: 0 }, None);
        published(&mut former, 0..50);
        let state = former.checkpoint().unwrap();
        for (stage, is_another) in [("rk4", true), ("mobius", false)] {
            let mut candidate = service(stage, Role::Candidate, Some(&state));
            assert_eq!(published(&mut candidate, 50..60), []);
            let state = candidate.checkpoint().unwrap();
            let mut owner = service(stage, Role::Owner { from_tick: 70 }, Some(&state));
            let expected: Vec<_> = (70..80).map(|tick| (tick, is_another && tick == 70)).collect();
            assert_eq!(published(&mut owner, 60..80), expected, "{stage}");
        }
    }
    #[test]
    fn who_goes_on_without_some_inputs_says_so_with_the_first_output_that_is_new() {
        let mut former = service("mobius", Role::Owner { from_tick: 0 }, None);
        published(&mut former, 0..50);
        let state = former.checkpoint().unwrap();
        for (first, misses) in [(50, false), (55, true)] {
            let mut owner = service_at("mobius", Role::Owner { from_tick: 0 }, Some(&state), 60);
            flagged(&mut owner, first..60, Flags::LOST_BEFORE);
            let expected: Vec<_> = (60..70).map(|tick| (tick, misses && tick == 60)).collect();
            assert_eq!(flagged(&mut owner, 60..70, Flags::LOST_BEFORE), expected);
        }
    }
}
