//! Decisions on events, as methods of [`Supervision`](crate::Supervision).
//!
//! | module | decides on |
//! | --- | --- |
//! | [`restart`] | when a service is restarted or given up |
//! | [`swaps`] | ownership of the slots; swap requests |
//! | [`swap_timing`] | time limits and attempts of a swap, and the margin before the hand-over |
//! | [`watch`] | automatic promotion of shadows |
//! | [`flow`] | readiness, credit for the source, shutdown |
//! | [`renewal`] | replacement of a bus whose files were removed |
//! | [`history`] | events published while the system runs |

mod flow;
mod history;
mod renewal;
mod restart;
mod swap_timing;
mod swaps;
mod watch;
