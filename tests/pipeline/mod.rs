//! The data path on real processes: recordings, bad input, determinism, conventions, scores.

mod accuracy;
mod bad_input;
pub(crate) mod bus_source;
mod conventions;
mod detect;
mod determinism;
mod drivers;
mod fault_injection;
mod import;
mod notebook;
mod output;
mod python_sensor;
mod remedies;
mod replay;
mod reports;
mod score;
mod score_errors;
mod score_estimate;
mod score_files;
mod score_report;
mod serial_tutorial;
mod sources;
mod true_north;
mod warm_start;
