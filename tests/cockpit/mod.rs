//! Tests of the cockpit in a browser and with other clients: values, access control and cost.

mod access;
mod browser;
mod cost;
mod fleet;
#[cfg(feature = "foxglove")]
mod foxglove;
mod metrics;
mod operator;
mod page;
mod readme;
mod recorded;
mod sensors;
mod tls;
