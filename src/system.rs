//! Command-line arguments that select a system: one on this machine, or a remote vehicle.

use std::path::{Path, PathBuf};

use clap::Args;
use launch::Launch;

use crate::remote::RemoteEndpoint;

/// Selection of a system on this machine.
#[derive(Args)]
pub(crate) struct LocalSystemArgs {
    /// System name [default: that of ./launch.toml, else plumbline]
    #[arg(long = "system", value_name = "NAME")]
    name: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Selection of a system on this machine or of a remote vehicle.
#[derive(Args)]
pub(crate) struct SystemArgs {
    #[command(flatten)]
    local: LocalSystemArgs,
    /// Remote vehicle to use instead of a system on this machine
    #[arg(long, value_name = "VEHICLE", conflicts_with = "name")]
    remote: Option<String>,
    #[command(flatten)]
    endpoint: EndpointArgs,
}

/// Selection of the endpoint of remote vehicles.
#[derive(Args)]
pub(crate) struct EndpointArgs {
    /// Gateway or router endpoint, repeatable [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Folder of `plumb keys` with the certificate for quic/ endpoints
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl EndpointArgs {
    pub(crate) fn endpoint(&self) -> RemoteEndpoint {
        RemoteEndpoint::new(&self.connect, self.keys.as_deref())
    }
}

impl SystemArgs {
    pub(crate) fn json(&self) -> bool {
        self.local.json
    }

    pub(crate) fn name(&self) -> String {
        self.local.name()
    }

    /// Returns the name and endpoint of the remote vehicle, if selected.
    pub(crate) fn remote(&self) -> Option<(&str, RemoteEndpoint)> {
        Some((self.remote.as_deref()?, self.endpoint.endpoint()))
    }
}

impl LocalSystemArgs {
    /// Returns `true` if the system was named on the command line.
    pub(crate) fn is_named(&self) -> bool {
        self.name.is_some()
    }

    pub(crate) fn name(&self) -> String {
        system_name(self.name.as_deref())
    }
}

/// Returns the given name, or that of ./launch.toml, or the default.
pub(crate) fn system_name(named: Option<&str>) -> String {
    let from_file = || Some(Launch::read(Path::new("launch.toml")).ok()?.name);
    named.map(str::to_owned).or_else(from_file).unwrap_or_else(|| Launch::default().name)
}
