//! `plumb completions` and `plumb man`: completion scripts and manual pages, generated from the
//! definition of the command line.

use std::{fs, path::Path, process::ExitCode};

use clap::Command;
use clap_complete::Shell;
use foreign::ForeignText;

use crate::{failure::fail, stdout::print};

/// Prints the completion script of a shell.
pub(crate) fn print_completions(mut command: Command, shell: Shell) -> ExitCode {
    let mut script = Vec::new();
    let name = command.get_name().to_owned();
    clap_complete::generate(shell, &mut command, name, &mut script);
    print(&String::from_utf8_lossy(&script).trim_end())
}

/// Writes a manual page for each command into a folder. The page of a subcommand is named like
/// `plumb-topic-echo.1`.
pub(crate) fn write_pages(command: Command, folder: &Path) -> ExitCode {
    match fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(cause) => {
            let folder = ForeignText::from(folder.to_string_lossy().into_owned());
            fail(&format_args!("cannot write manual pages to {folder}: {cause}"), 1)
        }
    }
}
