//! The service `course`: runs the slot [`slots::course`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::Service;
use messages::{FusedState, GnssFix};
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, or if the bus or the stage fails.
pub fn run() -> Result<(), RuntimeError> {
    let context = ServiceContext::join(Service::Course)?;
    let slot = slots::course::slot(&context.config)?;
    let (fused, gnss) = (context.ordered_subscriber::<FusedState>()?, context.subscriber::<GnssFix>()?);
    serve(context, slot, &[&fused, &gnss])
}
