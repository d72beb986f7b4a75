//! Imports of generated, real and damaged recordings, compared with the reference readers of their
//! formats.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod ardupilot;
mod bags;
mod common;
mod damage;
mod flights;
mod pyulog;
mod formats;
mod ulog;
mod errors;
mod fuzz;
mod pipeline;
#[path = "../../../../tests/common/python.rs"]
mod python;
mod scripts;
mod csv;
