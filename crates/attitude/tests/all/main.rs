//! Integration tests of `attitude`, in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod aided;
mod broad;
mod calibration;
mod common;
mod contracts;
mod course;
mod deviations;
mod field;
mod filters;
mod flight;
mod hand_over;
mod heading;
mod identities;
mod level;
mod levelling;
mod multiple_model;
mod scalars;
mod scenarios;
mod sets;
mod steps;
mod vehicles;
mod warm_start;
