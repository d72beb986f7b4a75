//! `plumb config`: checks and shows launch files, and derives systemd settings from them.

use std::{fs, process::ExitCode};

use clap::Subcommand;
use launch::Launch;

use crate::{
    absent,
    failure::{Failure, OrFail as _, Outcome},
    notice::notice,
    stdout::print,
    system::LaunchArgs,
};

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

pub(crate) fn run(command: &Config) -> Outcome {
    match command {
        Config::Check { launch } => {
            read(launch)?;
            match launch.path() {
                Some(file) => notice(format_args!("{} is valid", foreign::path(file))),
                None => notice("no ./launch.toml; the built-in launch file is valid"),
            }
            Ok(ExitCode::SUCCESS)
        }
        Config::Show { launch } => Ok(print(&effective_text(launch)?)),
        Config::Unit { launch } => Ok(print(&read(launch)?.unit_drop_in().or_fail(3)?.trim_end())),
    }
}

/// Returns the text of the launch file, completed with the default of every key that it leaves
/// unset.
fn effective_text(launch: &LaunchArgs) -> Result<String, Failure> {
    read(launch)?;
    let read = |file| fs::read_to_string(file).map_err(|cause| format!("cannot read {}: {cause}", foreign::path(file)));
    let text = launch.path().map(read).transpose().or_fail(3)?.unwrap_or_default();
    launch::effective_text(&text).or_fail(3)
}

/// Reads a launch file and checks that this build has its services.
fn read(launch: &LaunchArgs) -> Result<Launch, Failure> {
    let launch = launch.read()?;
    absent::find_absent_service(&launch).map_or(Ok(launch), |error| Err(Failure::new(error, 3)))
}
