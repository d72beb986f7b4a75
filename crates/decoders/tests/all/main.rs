//! Decoders on bytes that others encoded, and on bytes that are damaged.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod autopilot;
mod damage;
mod foreign;
mod iio;
mod lines;
#[path = "../../../../tests/common/python.rs"]
mod python;
mod receivers;
mod sensors;
mod streams;
