//! The graph of the system: every topic with its publisher and subscribers.
//!
//! The [topic table](topics) is the single definition. Everything else is derived from it.
//!
//! Output: constants.
//!
//! Failure: an inconsistent table does not compile.
//!
//! | module | contents |
//! | --- | --- |
//! | [`table`](topics) | the table, one line per topic |
//! | [`service`] | services and other participants |
//! | [`stage_config`](StageConfig) | stage and parameters of a slot |
//! | [`topic`] | the entry of a topic, and [`Topic`], an enum with one variant per line |
//! | [`edges`] | queries: inputs and outputs of a service, downstream services, carried topics |
#![forbid(unsafe_code)]

pub mod edges;
pub mod service;
mod stage_config;
mod table;
pub mod topic;

pub use attitude::slot::Slot;
pub use edges::{GRAPH, Graph};
pub use service::{Participant, Service};
pub use stage_config::StageConfig;
pub use topic::{Buffer, Entry, Presence, Topic};
