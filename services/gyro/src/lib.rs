//! The service `gyro`: runs the slot [`slots::gyro`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::Service;
use messages::ImuSample;
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the service cannot join the system, build its stage or continue.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Gyro)?;
    let slot = slots::gyro::slot(&context.config)?;
    let imu = context.subscriber::<ImuSample>()?;
    serve(context, slot, &[&imu])
}
