//! `plumb config`: checks and shows launch files, and derives settings of systemd from them.

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Subcommand;
use launch::Launch;

use crate::{absent, failure::fail, notice::notice, stdout::print};

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
    /// Print a launch file with the default of every key it does not set
    #[command(after_help = "\
Examples:
  plumb config show
  plumb config show launch.toml
  plumb config show deploy/split/board.toml

The output is a valid launch file. Relative paths in it stay relative to the
folder of the given file.")]
    Show {
        /// Launch file [default: ./launch.toml, else the built-in one]
        file: Option<PathBuf>,
    },
    /// Print the systemd drop-in for the devices and networks of a launch file
    #[command(after_help = "\
Examples:
  plumb config unit launch.toml
  plumb config unit /etc/plumbline/launch.toml

Install the output as /etc/systemd/system/plumbline.service.d/launch.conf.
Without it, plumbline.service has no access to devices and networks
(docs/how-to/deploy.md).")]
    Unit {
        /// Launch file of the service
        file: PathBuf,
    },
}

pub(crate) fn run(command: &Config) -> ExitCode {
    let result = match command {
        Config::Check { file } => read(file).map(|_| {
            notice(format_args!("{} is valid", foreign::path(file)));
            ExitCode::SUCCESS
        }),
        Config::Show { file } => effective_text(file.as_deref()).map(|text| print(&text)),
        Config::Unit { file } => read(file).map(|launch| match launch.unit_drop_in() {
            Ok(drop_in) => print(&drop_in.trim_end()),
            Err(error) => fail(&error, 3),
        }),
    };
    result.unwrap_or_else(|failure| failure)
}

/// Returns a launch file with the default of every key that it does not set. A failure is reported,
/// and its exit code returned.
fn effective_text(file: Option<&Path>) -> Result<String, ExitCode> {
    let default = Path::new("launch.toml");
    let Some(file) = file.or_else(|| default.exists().then_some(default)) else {
        return launch::effective_text("").map_err(|error| fail(&error, 3));
    };
    read(file)?;
    let text = fs::read_to_string(file)
        .map_err(|cause| fail(&format_args!("cannot read {}: {cause}", foreign::path(file)), 3))?;
    launch::effective_text(&text).map_err(|error| fail(&error, 3))
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
