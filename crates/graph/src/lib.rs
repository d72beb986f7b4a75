//! The graph of the system: services, and topics with their publishers and subscribers.
//!
//! The [topic table](topics) and the [service table](services) are the only definitions.
//! Everything else is derived from them.
//!
//! Output: constants.
//!
//! Failure: an inconsistent table does not compile.
//!
//! | module | contents |
//! | --- | --- |
//! | [`topic_table`](topics) | the topic table, one line per topic |
//! | [`service_table`](services) | the service table, one line per service |
//! | [`service`] | [`Service`], an enum with one variant per line, and other participants |
//! | [`stage_config`](StageConfig) | stage and parameters of a slot |
//! | [`topic`] | the entry of a topic, and [`Topic`], an enum with one variant per line |
//! | [`edges`] | queries: inputs and outputs of a service, downstream services, carried topics |
#![forbid(unsafe_code)]

pub mod edges;
pub mod service;
mod service_table;
mod stage_config;
pub mod topic;
mod topic_table;

pub use attitude::slot::Slot;
pub use edges::{GRAPH, Graph};
pub use service::{Participant, Service};
pub use stage_config::StageConfig;
pub use topic::{Buffer, Entry, Presence, Topic};
