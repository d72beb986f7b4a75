//! The slots of the data path, as values that map messages to messages.
//!
//! The services run them as processes on the bus. `pipeline` runs them in one process, and the
//! simulator runs them on a simulated bus.
//!
//! | module | contents |
//! | --- | --- |
//! | [`gyro`] | angular rate to the rotation of each tick |
//! | [`accel`] | specific force to the up direction |
//! | [`fuser`] | rotation, up direction, magnetic field and fixes to attitude |
//! | [`course`] | attitude and fixes to angles, course and quaternion |
//! | `true_north` | magnetic declination |
#![forbid(unsafe_code)]

pub mod accel;
pub mod course;
pub mod fuser;
pub mod gyro;
mod true_north;

use launch::Slot;
use runtime::{RuntimeError, ServiceContext, ServiceLoop, SlotLoop};

/// Starts the main loop of the service of a slot.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, the stage cannot be built, or the bus fails.
pub fn start(slot: Slot, context: ServiceContext) -> Result<Box<dyn ServiceLoop>, RuntimeError> {
    let config = &context.config;
    Ok(match slot {
        Slot::Gyro => {
            let (slot, inputs) = (gyro::slot(config)?, gyro::subscribe(&context)?);
            Box::new(SlotLoop::start(context, slot, inputs)?)
        }
        Slot::Accel => {
            let (slot, inputs) = (accel::slot(config)?, accel::subscribe(&context)?);
            Box::new(SlotLoop::start(context, slot, inputs)?)
        }
        Slot::Fuser => {
            let (slot, inputs) = (fuser::slot(config)?, fuser::subscribe(&context)?);
            Box::new(SlotLoop::start(context, slot, inputs)?)
        }
        Slot::Course => {
            let (slot, inputs) = (course::slot(config)?, course::subscribe(&context)?);
            Box::new(SlotLoop::start(context, slot, inputs)?)
        }
    })
}
