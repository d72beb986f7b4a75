//! The cockpit as a browser shows it: what is drawn is what was sent, and nobody else can do anything.

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
