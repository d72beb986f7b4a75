//! The slot `accel`: from `imu` to `accel`, where up seems to be at each tick.
//!
//! Input: checked IMU samples. Output: the point w_acc. Time: none. Failure: a force that cannot be used keeps the last point, with
//! trust 0 and its flag.
#![forbid(unsafe_code)]

use attitude::{
    accel::{Accelerometer, FORCE_MIN_M_S2},
    stage::Stage,
};
use launch::Service;
use messages::{AccelPoint, Flags, Header, ImuSample, pair};
use runtime::{EachTick, Member, Orders, RuntimeError, Work, serve, stage};

/// The work of the slot.
#[derive(Debug, Clone)]
pub struct AccelWork {
    stage: Accelerometer,
}

/// The slot with the stage that `orders` name.
pub fn slot(orders: &Orders) -> Result<EachTick<AccelWork>, RuntimeError> {
    let stage = stage::filled(Service::Accel, &orders.launch.accel, Accelerometer::named)?;
    Ok(EachTick::new(AccelWork { stage }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let member = Member::join(Service::Accel)?;
    let slot = slot(&member.orders)?;
    let imu = member.subscriber::<ImuSample>()?;
    serve(member, slot, &[&imu])
}

impl Work for AccelWork {
    type Input = ImuSample;
    type Output = AccelPoint;
    type Stage = Accelerometer;

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

    fn stage(&self) -> &Accelerometer {
        &self.stage
    }

    fn stage_mut(&mut self) -> &mut Accelerometer {
        &mut self.stage
    }

    fn visit_own(&mut self, _visit: &mut dyn FnMut(&mut u64)) {}
}
