//! Observation of a running system for `plumb top`, `plumb topic` and `plumb doctor`.
//!
//! - Input: messages as bytes with their layout, service status from the supervisor, /proc and
//!   /sys.
//! - Output: text for users, JSON for scripts.
//! - Time: message timestamps, or the observer's clock for messages that have no timestamp.
//! - Failure: a value that cannot be determined is reported as unknown.
//!
//! An observer publishes nothing, creates no topic and never makes a service wait.
//!
//! | module | contents |
//! | --- | --- |
//! | [`decode`] | decoding of a message by its layout: names, units, values |
//! | [`tables`] | CSV tables of messages |
//! | [`flow`], [`interval`] | rate, intervals, bandwidth and losses of a topic |
//! | [`readings`] | raw sensor readings for a calibration |
//! | [`topics`] | list and description of topics |
//! | [`hops`], [`process`], [`top`] | latency and resource usage of each service |
//! | [`system_recording`], [`late_topic`] | recording of a running system to a file |
//! | [`doctor`] | diagnosis of the machine and the system |
#![forbid(unsafe_code)]

pub mod decode;
pub mod doctor;
pub mod flow;
pub mod hops;
pub mod interval;
pub mod late_topic;
pub mod process;
pub mod readings;
pub mod system_recording;
pub mod tables;
pub mod top;
pub mod topics;
