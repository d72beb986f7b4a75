//! The slot `accel`: from `imu` to `accel`, where up seems to be at each tick.
//!
//! Input: checked IMU samples. Output: the point w_acc. Time: none. Failure: a force that cannot be used keeps the last point, with
//! trust 0 and its flag.
#![forbid(unsafe_code)]

use attitude::{
    Vector3,
    accel::{Accelerometer, FORCE_MIN_M_S2, Inclination},
    point::Point,
    stage::Stage,
};
use launch::Service;
use messages::{AccelPoint, Flags, Header, ImuSample, pair};
use runtime::{EachTick, Member, Orders, RuntimeError, Work, serve, stage};

/// A stage that the slot takes.
pub trait AccelStage: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone {}

impl<S: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone> AccelStage for S {}

/// The work of the slot.
#[derive(Debug, Clone)]
pub struct AccelWork<S = Accelerometer> {
    stage: S,
}

/// The slot with the stage that `orders` name.
pub fn slot(orders: &Orders) -> Result<EachTick<AccelWork>, RuntimeError> {
    slot_with(orders, Accelerometer::named)
}

fn slot_with<S: AccelStage>(
    orders: &Orders,
    named: impl FnOnce(&str) -> Option<S>,
) -> Result<EachTick<AccelWork<S>>, RuntimeError> {
    let stage = stage::filled(Service::Accel, &orders.launch.accel, named)?;
    Ok(EachTick::new(AccelWork { stage }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    run_with(Accelerometer::named)
}

/// The service with stages of one's own: `named` makes the one of that name.
pub fn run_with<S: AccelStage>(named: impl FnOnce(&str) -> Option<S>) -> Result<(), RuntimeError> {
    let member = Member::join(Service::Accel)?;
    let slot = slot_with(&member.orders, named)?;
    let imu = member.subscriber::<ImuSample>()?;
    serve(member, slot, &[&imu])
}

impl<S: AccelStage> Work for AccelWork<S> {
    type Input = ImuSample;
    type Output = AccelPoint;
    type Stage = S;

    fn work(&mut self, input: &ImuSample, mut header: Header) -> AccelPoint {
        let seen = self.stage.step(&input.force_m_s2.into());
        header.flags |= Flags::FORCE_SMALL.when(seen.norm_m_s2 < FORCE_MIN_M_S2);
        AccelPoint {
            header,
            w: pair(seen.up.w),
            chart: seen.up.chart.into(),
            norm_m_s2: seen.norm_m_s2,
            trust: seen.trust,
            force_m_s2: input.force_m_s2,
        }
    }

    fn stage(&self) -> &S {
        &self.stage
    }

    fn stage_mut(&mut self) -> &mut S {
        &mut self.stage
    }

    fn visit_own(&mut self, _visit: &mut dyn FnMut(&mut u64)) {}
}
