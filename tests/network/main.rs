//! Beyond the board: gateway, stations, certificates, split systems, foreign clients, rough networks.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../common/mod.rs"]
mod common;

mod certificates;
mod docs;
mod elsewhere;
mod foreign;
mod gateway;
mod rough_network;
mod split;
mod strangers;
