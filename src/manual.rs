//! `plumb completions` and `plumb man`: completion scripts and manual pages, generated from the
//! definition of the command line.

use std::{fs, path::Path, process::ExitCode};

use crate::{
    failure::{Failure, Outcome},
    stdout::print,
};
use clap::Command;
use clap_complete::Shell;

/// Prints the completion script of a shell.
pub(crate) fn print_completions(mut command: Command, shell: Shell) -> Outcome {
    let mut script = Vec::new();
    let name = command.get_name().to_owned();
    clap_complete::generate(shell, &mut command, name, &mut script);
    Ok(print(&String::from_utf8_lossy(&script).trim_end()))
}

/// Writes a manual page for each command into a folder. The page of a subcommand is named like
/// `plumb-topic-echo.1`.
pub(crate) fn write_pages(command: Command, folder: &Path) -> Outcome {
    let written = fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder));
    let failed =
        |cause| Failure::new(format_args!("cannot write manual pages to {}: {cause}", foreign::path(folder)), 1);
    written.map(|()| ExitCode::SUCCESS).map_err(failed)
}
