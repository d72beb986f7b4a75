//! State of a supervision. Events of the system as a whole are handled by the methods in
//! `decisions`.
//!
//! | module | contents |
//! | --- | --- |
//! | [`process`], [`restart_policy`] | services and their processes; recent restarts |
//! | [`checkpoint_store`] | the state a service resumes from |
//! | [`swaps`], [`pending_swaps`] | ownership of the slots; swap requests |
//! | [`stage_history`] | stages that have owned a slot |
//! | [`promotion`] | promotion rules and their progress |
//! | [`flow`] | progress from start to shutdown |
//! | [`renewal`] | replacements of the bus |

pub(crate) mod checkpoint_store;
pub(crate) mod flow;
pub(crate) mod pending_swaps;
pub(crate) mod process;
pub(crate) mod promotion;
pub(crate) mod renewal;
pub(crate) mod restart_policy;
pub(crate) mod stage_history;
pub(crate) mod swaps;
