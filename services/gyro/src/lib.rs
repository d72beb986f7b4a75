//! The slot `gyro`: from `imu` to `gyro`, the motion of each tick.
//!
//! Input: checked IMU samples. Output: the step's turn and the open-loop attitude. Time: the samples' own. Failure: ticks that never
//! came are bridged by the mean of the rates around them, no longer than [`BRIDGE_S`]; over a longer gap the attitude is held.
#![forbid(unsafe_code)]

use attitude::{
    accel::FORCE_MIN_M_S2,
    gyro::{Gyro, GyroStage, RateKind, RateSample},
    point::Point,
    state::Attitude,
};
use launch::Service;
use messages::{Flags, GyroStep, Header, ImuSample, pair};
use runtime::{BRIDGE_S, EachTick, Member, Orders, RuntimeError, Work, serve, stage, words::Words};

/// The work of the slot.
#[derive(Debug, Clone)]
pub struct GyroWork<S = Gyro> {
    stage: S,
    aligned: bool,
    t_end_ns: Option<i64>,
}

/// The slot with the stage that `orders` name.
pub fn slot(orders: &Orders) -> Result<EachTick<GyroWork>, RuntimeError> {
    slot_with(orders, Gyro::named)
}

fn slot_with<S: GyroStage>(
    orders: &Orders,
    named: impl FnOnce(&str) -> Option<S>,
) -> Result<EachTick<GyroWork<S>>, RuntimeError> {
    let stage = stage::filled(Service::Gyro, &orders.launch.gyro, named)?;
    Ok(EachTick::new(GyroWork { stage, aligned: false, t_end_ns: None }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    run_with(Gyro::named)
}

/// The service with stages of one's own: `named` makes the one of that name.
pub fn run_with<S: GyroStage>(named: impl FnOnce(&str) -> Option<S>) -> Result<(), RuntimeError> {
    let member = Member::join(Service::Gyro)?;
    let slot = slot_with(&member.orders, named)?;
    let imu = member.subscriber::<ImuSample>()?;
    serve(member, slot, &[&imu])
}

impl<S: GyroStage> GyroWork<S> {
    /// The open-loop attitude starts level with the first force that has a direction.
    fn align(&mut self, input: &ImuSample) {
        let force_m_s2 = input.force_m_s2.into();
        if input.header.flags.any(Flags::FORCE_INVALID | Flags::FORCE_SMALL) {
            return;
        }
        if let Some(up) = Point::of(force_m_s2).filter(|_| force_m_s2.norm() >= FORCE_MIN_M_S2) {
            self.stage.align(Attitude::levelled(up));
            self.aligned = true;
        }
    }
}

impl<S: GyroStage> Work for GyroWork<S> {
    type Input = ImuSample;
    type Output = GyroStep;
    type Stage = S;

    fn work(&mut self, input: &ImuSample, header: Header) -> GyroStep {
        let before_ns = self.t_end_ns.replace(header.t_end_ns).unwrap_or(header.t_start_ns);
        let dt_s = (header.t_end_ns - before_ns) as f64 * 1e-9;
        let kind = if header.flags.any(Flags::RATE_INSTANT) { RateKind::Instant } else { RateKind::Mean };
        let dt_s = if dt_s <= BRIDGE_S { dt_s } else { 0.0 };
        let mut motion = self.stage.step(&RateSample { rate_rad_s: input.rate_rad_s.into(), dt_s, kind });
        if !self.aligned {
            self.align(input);
            motion.attitude = self.stage.common();
        }
        GyroStep {
            header,
            w: pair(motion.attitude.up.w),
            z_rad: motion.attitude.z_rad,
            chart: motion.attitude.up.chart.into(),
            p: pair(motion.turn.p),
            s: pair(motion.turn.s),
            rate_rad_s: motion.rate_rad_s.into(),
        }
    }

    fn stage(&self) -> &S {
        &self.stage
    }

    fn stage_mut(&mut self) -> &mut S {
        &mut self.stage
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.aligned.visit(visit);
        self.t_end_ns.visit(visit);
    }
}
