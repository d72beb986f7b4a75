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
