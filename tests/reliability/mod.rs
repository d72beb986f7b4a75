//! Disturbances of a running system: kills, freezes, swaps and user-defined stages.

mod aborted;
mod file_access;
mod flight;
mod flight_replay;
mod notify;
mod own_stage;
mod removed_files;
mod rescue;
mod restart;
mod run_report;
mod swap;
mod watch;
