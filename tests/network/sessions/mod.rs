//! Access control of real Zenoh sessions with the configurations that `plumb keys` writes.

mod access;
mod connections;
mod direct;
mod saturated_link;
mod site;
mod tick_import;
