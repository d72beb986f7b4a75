//! Tests of the decoders with bytes of third-party encoders and with damaged bytes.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod autopilot;
mod damage;
mod iio;
mod lines;
#[path = "../../../../tests/common/python.rs"]
mod python;
mod receivers;
mod sensors;
mod streams;
mod third_party;
