//! The service `gyro`: runs the slot [`slots::gyro`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::{Service, Slot};
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the service cannot join the system, build its stage or continue.
pub fn run() -> Result<(), RuntimeError> {
    serve(&mut *slots::start(Slot::Gyro, ServiceContext::join(Service::Gyro)?)?)
}
