//! The service `course`: runs the slot [`slots::course`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::{Service, Slot};
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, or if the bus or the stage fails.
pub fn run() -> Result<(), RuntimeError> {
    serve(&mut *slots::start(Slot::Course, ServiceContext::join(Service::Course)?)?)
}
