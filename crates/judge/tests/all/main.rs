//! What is said of recordings, logs and simulations, as they are and with mistakes, and of anything.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod anything;
mod common;
mod logs;
mod recordings;
mod turned;
