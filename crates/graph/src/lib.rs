//! The graph of the system: every topic, who publishes it, who reads it. It stands here once, and everything else derives from it.
//!
//! Input, output: constants. Time: none. Failure: none; what does not fit together does not compile.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`table`](topics) | the table itself: a line for each topic |
//! | [`service`] | the services and slots, and who else takes part |
//! | [`topic`] | what a line says, and [`Topic`], one for each |
//! | [`edges`] | what follows: inputs and outputs of a service, its readers, what can be carried to another host |
#![forbid(unsafe_code)]

pub mod edges;
pub mod service;
mod table;
pub mod topic;

pub use edges::{GRAPH, Graph};
pub use service::{Participant, Service};
pub use topic::{Buffer, Entry, Presence, Topic};
