//! The service `accel`: runs the slot [`slots::accel`] as a process on the bus.
#![forbid(unsafe_code)]

use launch::{Service, Slot};
use runtime::{RuntimeError, ServiceContext, serve};

/// Runs the service until it is requested to stop.
///
/// # Errors
///
/// Returns an error if the service cannot join the system, build its stage or continue.
pub fn run() -> Result<(), RuntimeError> {
    serve(&mut *slots::start(Slot::Accel, ServiceContext::join(Service::Accel)?)?)
}
