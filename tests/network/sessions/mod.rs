//! Who may connect, read, command or speak for another: real Zenoh sessions with the configurations that `plumb keys` writes.

mod access;
mod both_ways;
mod carrying;
mod connections;
mod direct;
mod site;
