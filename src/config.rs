//! `plumb config`: checks and shows launch files, and derives systemd settings from them.

use std::{fs, process::ExitCode};

use clap::Subcommand;
use launch::Launch;

use crate::{absent, failure::fail, notice::notice, stdout::print, system::LaunchArgs};

#[derive(Subcommand)]
pub(crate) enum Config {
    /// Check a launch file and print each problem with its line
    #[command(after_help = "\
Examples:
  plumb config check
  plumb config check --launch deploy/split/board.toml")]
    Check {
        #[command(flatten)]
        launch: LaunchArgs,
    },
    /// Print a launch file with the default of every key it does not set
    #[command(after_help = "\
Examples:
  plumb config show
  plumb config show --launch deploy/split/board.toml

The output is a valid launch file. Relative paths in it stay relative to the
folder of the given file.")]
    Show {
        #[command(flatten)]
        launch: LaunchArgs,
    },
    /// Print the systemd drop-in for the devices and networks of a launch file
    #[command(after_help = "\
Examples:
  plumb config unit
  plumb config unit --launch /etc/plumbline/launch.toml

Install the output as /etc/systemd/system/plumbline.service.d/launch.conf.
Without it, plumbline.service has no access to devices and networks
(docs/how-to/deploy.md).")]
    Unit {
        #[command(flatten)]
        launch: LaunchArgs,
    },
}

pub(crate) fn run(command: &Config) -> ExitCode {
    let result = match command {
        Config::Check { launch } => read(launch).map(|_| {
            match launch.path() {
                Some(file) => notice(format_args!("{} is valid", foreign::path(file))),
                None => notice("no ./launch.toml; the built-in launch file is valid"),
            }
            ExitCode::SUCCESS
        }),
        Config::Show { launch } => effective_text(launch).map(|text| print(&text)),
        Config::Unit { launch } => read(launch).map(|launch| match launch.unit_drop_in() {
            Ok(drop_in) => print(&drop_in.trim_end()),
            Err(error) => fail(&error, 3),
        }),
    };
    result.unwrap_or_else(|failure| failure)
}

/// Returns the text of the launch file, completed with the default of every key that it leaves
/// unset. On failure, prints the error and returns its exit code.
fn effective_text(launch: &LaunchArgs) -> Result<String, ExitCode> {
    read(launch)?;
    let text = launch.path().map_or_else(
        || Ok(String::new()),
        |file| {
            fs::read_to_string(file)
                .map_err(|cause| fail(&format_args!("cannot read {}: {cause}", foreign::path(file)), 3))
        },
    )?;
    launch::effective_text(&text).map_err(|error| fail(&error, 3))
}

/// Reads a launch file and checks that this build has its services. On failure, prints the error
/// and returns its exit code.
fn read(launch: &LaunchArgs) -> Result<Launch, ExitCode> {
    let launch = launch.read().map_err(|error| fail(&error, 3))?;
    match absent::find_absent_service(&launch) {
        Some(error) => Err(fail(&error, 3)),
        None => Ok(launch),
    }
}
