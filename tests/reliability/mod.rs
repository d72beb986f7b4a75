//! What disturbs a running system: kills, freezes, swaps that succeed and that fail, stages of one's own.

mod aborted;
mod damage;
mod files;
mod flight;
mod flown_again;
mod notify;
mod own_stage;
mod record;
mod rescue;
mod restart;
mod swap;
mod watch;
