//! The slot `accel`: from `imu` to `accel`, where up seems to be at each tick.
//!
//! Input: checked IMU samples. Output: the point w_acc. Time: none. Failure: a force that cannot be used keeps the last point, with
//! trust 0 and its flag.
#![forbid(unsafe_code)]

use attitude::accel::{Accelerometer, FORCE_MIN_M_S2};
use host::AnyStage;
use launch::Service;
use messages::{AccelPoint, Flags, Header, ImuSample};
use runtime::{
    EachTick, RuntimeError, ServiceConfig, ServiceContext, Work,
    quantities::{chart_of, pair},
    serve,
    stage::{self, Filled},
};

/// The work of the slot.
#[derive(Debug)]
pub struct AccelWork {
    filled: Filled<AnyStage<Accelerometer>>,
}

/// The slot with the stage that `config` names.
pub fn slot(config: &ServiceConfig) -> Result<EachTick<AccelWork>, RuntimeError> {
    let filled = Filled::new(stage::chosen(Service::Accel, &config.launch, Accelerometer::named)?);
    Ok(EachTick::new(AccelWork { filled }))
}

/// The service.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Accel)?;
    let slot = slot(&context.config)?;
    let imu = context.subscriber::<ImuSample>()?;
    serve(context, slot, &[&imu])
}

impl Work for AccelWork {
    type Input = ImuSample;
    type Output = AccelPoint;
    type Stage = AnyStage<Accelerometer>;

    fn work(&mut self, input: &ImuSample, mut header: Header) -> Option<AccelPoint> {
        let (seen, anew) = self.filled.step(&input.force_m_s2.into())?;
        header.flags |= Flags::RESET.when(anew);
        header.flags |= Flags::FORCE_SMALL.when(seen.norm_m_s2 < FORCE_MIN_M_S2);
        Some(AccelPoint {
            header,
            w: pair(seen.up.w),
            chart: chart_of(seen.up.chart),
            norm_m_s2: seen.norm_m_s2,
            trust: seen.trust,
            force_m_s2: input.force_m_s2,
        })
    }

    fn filled(&self) -> &Filled<AnyStage<Accelerometer>> {
        &self.filled
    }

    fn filled_mut(&mut self) -> &mut Filled<AnyStage<Accelerometer>> {
        &mut self.filled
    }

    fn visit_own(&mut self, _visit: &mut dyn FnMut(&mut u64)) {}
}
