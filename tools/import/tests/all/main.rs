//! Imports of generated, real and damaged recordings, compared with the reference readers of their
//! formats.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod ardupilot;
mod bags;
mod common;
mod csv;
mod damage;
mod errors;
mod flights;
mod formats;
mod fuzz;
mod logs;
mod pipeline;
#[path = "../../../../tests/common/python.rs"]
mod python;
mod pyulog;
mod scripts;
mod ulog;
mod variants;
