//! Client that connects to remote vehicles through their gateways.
//!
//! Input: the telemetry and liveliness of each reachable vehicle.
//!
//! Output: received topics with delivery statistics, the state of each vehicle, requests to a
//! vehicle, and, with the feature `cockpit`, vehicles as sources of the cockpit.
//!
//! Time: every query and wait has a timeout.
//!
//! Failure: [`RemoteError`] names the cause. An unreachable vehicle is given up after a timeout.

#![forbid(unsafe_code)]

mod endpoint;
mod error;
pub mod fleet;
mod requests;
mod vehicle;
#[cfg(feature = "cockpit")]
mod vehicle_directory;
#[cfg(feature = "cockpit")]
mod vehicle_source;

pub use endpoint::RemoteEndpoint;
pub use error::RemoteError;
pub use requests::{services, swap};
pub use vehicle::{OnDelivery, RemoteTopic, RemoteVehicle};
#[cfg(feature = "cockpit")]
pub use vehicle_directory::RemoteDirectory;
