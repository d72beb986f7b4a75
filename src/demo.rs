//! `plumb demo`: a one-minute demonstration of a tumble, kills and swaps.

use std::{ops::ControlFlow, process::ExitCode};

use campaign::Demo;
use clap::Args;

use crate::{
    failure::{Outcome, fail_after_result},
    stdout::print_item,
};

/// Arguments of `plumb demo`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb demo
  plumb demo --stop

Exit codes: 0 no attitude lost or changed, 1 otherwise.")]
pub(crate) struct DemoCommand {
    /// System name
    #[arg(long = "system", value_name = "NAME", default_value_t = launch::Launch::default().name)]
    name: String,
    /// Stop the system at the end instead of letting it run until Ctrl-C
    #[arg(long)]
    stop: bool,
}

pub(crate) fn run(command: &DemoCommand) -> Outcome {
    let demo = Demo { name: command.name.clone(), has_cockpit: cfg!(feature = "cockpit"), stops: command.stop };
    let mut printed = ControlFlow::Continue(());
    let report = demo.run(&mut |line| {
        if printed.is_continue() {
            printed = print_item(&line);
        }
    })?;
    if !report.passed() {
        return Ok(fail_after_result(&"an attitude was lost or changed, see above", 1));
    }
    Ok(printed.break_value().unwrap_or(ExitCode::SUCCESS))
}
