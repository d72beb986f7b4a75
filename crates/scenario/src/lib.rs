//! Simulated motions and imperfect sensors.
//!
//! Input: the name of a scenario, or a motion, sensor errors and a seed.
//!
//! Output: the true attitude and the sensor readings at any time. The same seed gives the same
//! readings on every machine.
//!
//! Time: passed in by the caller.
//!
//! Failure: an unknown name, key or value is rejected with a list of the accepted ones.
//!
//! | scenario | motion |
//! | --- | --- |
//! | [`s1`] | reference scenario of Matveev 2025: pitch 25°, roll 30° at 0.05 Hz; yaw 1 °/s |
//! | [`tumble`] | 500 °/s about an axis oblique to all body axes, through the inverted attitude |
//! | [`s3`] | one full turn about each axis in sequence, with a magnetic field |
//! | [`coning`] | classical coning, without sensor errors |
//! | [`cruise`] | half an hour of flight with turns and satellite velocity |
//!
//! `cruise-hard` is `cruise` with wind, gusts, side slip and larger sensor errors.
//!
//! [`sensors`] simulates the readings. [`scenario`] combines a motion with its rate, duration and
//! sensor errors.
#![forbid(unsafe_code)]

pub mod coning;
pub mod cruise;
mod motion;
mod random;
pub mod s1;
pub mod s3;
pub mod scenario;
pub mod sensors;
mod truth;
pub mod tumble;

pub use motion::Motion;
pub use scenario::{PARAMETERS, Parameter, Scenario, ScenarioError};
pub use sensors::{
    Reading, Sensors,
    errors::{Coverage, Magnetometer, Receiver, SensorErrors},
};
pub use truth::Truth;
