//! Simulated motions: what a body does, and what imperfect sensors on it would read.
//!
//! Input: the name of a scenario, or a motion, the sensors' errors and a seed. Output: the true attitude and the readings at any
//! time. Time: given, never read. Failure: a name that does not exist is refused. The same seed gives the same readings on every
//! machine.
//!
//! | scenario | what the body does |
//! | --- | --- |
//! | [`s1`] | pitch 25° and roll 30° at 0.05 Hz, yaw 1 °/s: the reference scenario of Matveev 2025 |
//! | [`tumble`] | 500 °/s about an axis oblique to all three, through the inverted attitude |
//! | [`s3`] | one full turn about each axis in turn, with a magnetic field |
//! | [`coning`] | classical coning, no errors |
//! | [`cruise`] | half an hour of flight with turns, satellite velocity; `cruise-hard` with all that makes it hard |
//!
//! [`sensors`] reads them, [`scenario`] gives a motion the rate, duration and errors that belong to its name.
#![forbid(unsafe_code)]

pub mod coning;
pub mod cruise;
mod motion;
mod noise;
pub mod s1;
pub mod s3;
pub mod scenario;
pub mod sensors;
pub mod tumble;

pub use motion::{Motion, Truth};
pub use scenario::{PARAMETERS, Parameter, Scenario, ScenarioError};
pub use sensors::{
    Reading, Sensors,
    errors::{Coverage, Errors, Field, Receiver},
};
