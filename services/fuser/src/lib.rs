//! The service `fuser`: runs the slot [`slots::fuser`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::Service;
use messages::{AccelPoint, GnssFix, GyroStep, MagSample};
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, or if the bus or the stage fails.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Fuser)?;
    let slot = slots::fuser::slot(&context.config)?;
    let (gyro, accel) = (context.ordered_subscriber::<GyroStep>()?, context.ordered_subscriber::<AccelPoint>()?);
    let (mag, gnss) = (context.subscriber::<MagSample>()?, context.subscriber::<GnssFix>()?);
    let control = context.control()?;
    serve(context, slot, &[&gyro, &accel, &mag, &gnss, &control])
}
