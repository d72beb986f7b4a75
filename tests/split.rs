//! One system on two hosts.
mod common;
