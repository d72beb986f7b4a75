//! Systems with a gateway, and their remote clients.

use std::{
    fs,
    net::{TcpListener, UdpSocket},
    path::Path,
    process::Command,
};

use serde_json::Value;

use super::{System, plumb, wait_for};

/// Returns a port that is free for TCP and UDP.
pub(crate) fn free_port() -> u16 {
    let one = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut ports = std::iter::repeat_with(one).take(100);
    ports.find(|port| UdpSocket::bind(("127.0.0.1", *port)).is_ok()).unwrap()
}

/// Creates a system with a gateway. `more` is appended to the `[gateway]` table.
pub(crate) fn with_gateway(port: u16, more: &str) -> System {
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[gateway]\nlisten = [\"tcp/127.0.0.1:{port}\"]\n{more}"
    ))
}

pub(crate) fn ps(system: &System) -> Vec<Value> {
    system.ps()
}

/// Returns the gateway's entry in the output of `plumb ps`.
pub(crate) fn gateway(system: &System) -> Option<Value> {
    ps(system).into_iter().find(|one| one["service"] == "gateway")
}

/// Waits until the gateway listens and returns its endpoint.
pub(crate) fn endpoint(system: &System) -> String {
    let address = || Some(gateway(system)?["address"].as_str()?.to_owned());
    wait_for("the gateway to listen", || address().is_some());
    address().unwrap()
}

pub(crate) fn station(endpoints: &[&str], more: &[&str]) -> Command {
    let mut command = plumb(&["station", "--json"]);
    command.args(endpoints.iter().flat_map(|endpoint| ["--connect", endpoint]));
    command.args(more);
    command
}

/// Runs a command and returns the JSON value on its last line.
pub(crate) fn last_json(mut command: Command) -> Value {
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.lines().last().unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    serde_json::from_str(last).unwrap()
}

pub(crate) fn topic<'v>(vehicle: &'v Value, name: &str) -> &'v Value {
    let topics = vehicle["topics"].as_array().unwrap();
    topics.iter().find(|topic| topic["topic"] == name).unwrap_or_else(|| panic!("no {name}: {vehicle}"))
}

pub(crate) fn number(value: &Value, name: &str) -> u64 {
    value[name].as_u64().unwrap_or_else(|| panic!("no {name}: {value}"))
}

/// Returns the ticks in a table written by `plumb station --csv`, which are its first column.
pub(crate) fn ticks(table: &Path) -> Vec<u64> {
    let text = fs::read_to_string(table).unwrap();
    text.lines().skip(1).map(|line| line.split(',').next().unwrap().parse().unwrap()).collect()
}
