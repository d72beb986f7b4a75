//! The slots of the data path: types that turn input messages into output messages.
//!
//! The services run them as processes on the bus. `pipeline` runs them in one process, and the
//! simulator runs them on a simulated bus.
//!
//! | module | contents |
//! | --- | --- |
//! | [`gyro`] | rotation of each tick from the angular rate |
//! | [`accel`] | up direction from the specific force |
//! | [`fuser`] | attitude from rotation, up direction, magnetic field and fixes |
//! | [`course`] | angles, course and quaternion from attitude and fixes |
//! | `true_north` | magnetic declination |
#![forbid(unsafe_code)]

pub mod accel;
pub mod course;
pub mod fuser;
pub mod gyro;
mod true_north;

use launch::Slot;
use messages::ImuSample;
use runtime::{RuntimeError, ServiceConfig, ServiceContext, ServiceLoop, SlotInputs, SlotLoop, SlotProcessor};

/// Starts the main loop of the service of a slot.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, the stage cannot be built, or the bus fails.
pub fn start(slot: Slot, context: ServiceContext) -> Result<Box<dyn ServiceLoop>, RuntimeError> {
    match slot {
        Slot::Gyro => start_loop(context, gyro::slot, subscribe_imu),
        Slot::Accel => start_loop(context, accel::slot, subscribe_imu),
        Slot::Fuser => start_loop(context, fuser::slot, fuser::subscribe),
        Slot::Course => start_loop(context, course::slot, course::subscribe),
    }
}

fn subscribe_imu(context: &ServiceContext) -> Result<SlotInputs<ImuSample>, RuntimeError> {
    Ok(vec![Box::new(context.subscriber::<ImuSample>()?)])
}

fn start_loop<S: SlotProcessor + 'static>(
    context: ServiceContext,
    slot: fn(&ServiceConfig) -> Result<S, RuntimeError>,
    subscribe: fn(&ServiceContext) -> Result<SlotInputs<S::Input>, RuntimeError>,
) -> Result<Box<dyn ServiceLoop>, RuntimeError> {
    let (slot, inputs) = (slot(&context.config)?, subscribe(&context)?);
    Ok(Box::new(SlotLoop::start(context, slot, inputs)?))
}
