//! Command-line arguments that select a launch file and a system: one on this machine, or a remote
//! vehicle.

use std::path::{Path, PathBuf};

use clap::Args;
use launch::{Gateway, Launch, LaunchError};

use crate::remote::RemoteEndpoint;

/// Launch file that is read if none is named.
const DEFAULT_FILE: &str = "launch.toml";

/// Selection of a launch file.
#[derive(Args)]
pub(crate) struct LaunchArgs {
    /// Launch file [default: ./launch.toml, else the built-in one]
    #[arg(long = "launch", value_name = "FILE")]
    pub(crate) launch: Option<PathBuf>,
}

impl LaunchArgs {
    /// Returns the selected launch file; `None` for the built-in one.
    pub(crate) fn path(&self) -> Option<&Path> {
        let default = Path::new(DEFAULT_FILE);
        self.launch.as_deref().or_else(|| default.exists().then_some(default))
    }

    pub(crate) fn read(&self) -> Result<Launch, LaunchError> {
        self.path().map_or_else(|| Ok(Launch::default()), Launch::read)
    }
}

/// Selection of the name of a system on this machine.
#[derive(Args)]
pub(crate) struct SystemNameArgs {
    /// System name [default: that of the launch file]
    #[arg(long, value_name = "NAME", conflicts_with = "launch")]
    system: Option<String>,
    #[command(flatten)]
    pub(crate) launch: LaunchArgs,
}

impl SystemNameArgs {
    /// Returns `true` if the system was selected on the command line.
    pub(crate) fn is_named(&self) -> bool {
        self.system.is_some() || self.launch.launch.is_some()
    }

    pub(crate) fn name(&self) -> Result<String, LaunchError> {
        match &self.system {
            Some(name) => Ok(name.clone()),
            None => Ok(self.launch.read()?.name),
        }
    }
}

/// Selection of a system on this machine.
#[derive(Args)]
pub(crate) struct LocalSystemArgs {
    #[command(flatten)]
    pub(crate) selection: SystemNameArgs,
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
    #[arg(long, value_name = "VEHICLE", conflicts_with_all = ["system", "launch"])]
    remote: Option<String>,
    #[command(flatten)]
    endpoint: EndpointArgs,
}

/// Selection of the endpoint of remote vehicles.
#[derive(Args)]
pub(crate) struct EndpointArgs {
    /// Gateway or router endpoint, repeatable
    #[arg(long, value_name = "ENDPOINT", default_values_t = Gateway::default().listen)]
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

    pub(crate) fn name(&self) -> Result<String, LaunchError> {
        self.local.name()
    }

    /// Returns the name and endpoint of the remote vehicle, if selected.
    pub(crate) fn remote(&self) -> Option<(&str, RemoteEndpoint)> {
        Some((self.remote.as_deref()?, self.endpoint.endpoint()))
    }
}

impl LocalSystemArgs {
    pub(crate) fn name(&self) -> Result<String, LaunchError> {
        self.selection.name()
    }
}
