//! `plumb config`: checks launch files, and derives settings of systemd from them.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Subcommand;
use launch::Launch;

use crate::{absent, failure::fail, stdout::print};

#[derive(Subcommand)]
pub(crate) enum Config {
    /// Check a launch file and print each problem with its line
    #[command(after_help = "\
Examples:
  plumb config check launch.toml
  plumb config check deploy/split/board.toml")]
    Check {
        /// Launch file to check
        file: PathBuf,
    },
    /// Print the systemd drop-in for the devices and networks of a launch file
    #[command(after_help = "\
Examples:
  plumb config unit launch.toml
  plumb config unit /etc/plumbline/launch.toml

Install the output as /etc/systemd/system/plumbline.service.d/launch.conf. Without it,
plumbline.service has no access to devices and networks (docs/how-to/deploy.md).")]
    Unit {
        /// Launch file of the service
        file: PathBuf,
    },
}

pub(crate) fn run(command: &Config) -> ExitCode {
    let (Config::Check { file } | Config::Unit { file }) = command;
    let launch = match read(file) {
        Ok(launch) => launch,
        Err(failure) => return failure,
    };
    match command {
        Config::Check { .. } => {
            supervisor::announce(format_args!("{} is valid", foreign::path(file)));
            ExitCode::SUCCESS
        }
        Config::Unit { .. } => match launch.unit_drop_in() {
            Ok(drop_in) => print(&drop_in.trim_end()),
            Err(error) => fail(&error, 3),
        },
    }
}

/// Reads a launch file and checks that this build has its services. A failure is reported, and its
/// exit code returned.
fn read(file: &Path) -> Result<Launch, ExitCode> {
    let launch = Launch::read(file).map_err(|error| fail(&error, 3))?;
    match absent::find_absent_service(&launch) {
        Some(error) => Err(fail(&error, 3)),
        None => Ok(launch),
    }
}
