//! The cockpit as a browser shows it: what is drawn is what was sent, and nobody else can do anything.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../common/mod.rs"]
mod common;

mod browser;
mod cost;
mod fleet;
#[cfg(feature = "foxglove")]
mod foxglove;
mod metrics;
mod page;
mod recorded;
mod sensors;
mod strangers;
mod tls;
