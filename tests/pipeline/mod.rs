//! The data path on real processes: recordings, bad input, determinism, conventions, scores.

mod bad_input;
mod conventions;
mod determinism;
mod drivers;
mod fault_script;
mod import;
mod notebook;
mod orchestrated;
mod output;
mod python_sensor;
mod replay;
mod score;
mod score_errors;
mod score_files;
mod score_report;
mod serial_walk;
mod sources;
mod true_north;
mod warm_start;
