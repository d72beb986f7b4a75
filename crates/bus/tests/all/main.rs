//! Integration tests of `bus`, combined in one executable.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod observer;
mod owned_files;
mod topics;
