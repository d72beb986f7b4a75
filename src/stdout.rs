//! Standard output.
//!
//! A closed pipe, as with `head`, ends the output without an error.

use std::{
    fmt::Display,
    io::{self, ErrorKind, Write},
    ops::ControlFlow,
    process::ExitCode,
};

use console::Term;

use crate::failure::fail_after_result;

/// Prints the result of a command, or the last of several results, and returns the exit code.
pub(crate) fn print(text: &dyn Display) -> ExitCode {
    print_item(text).break_value().unwrap_or(ExitCode::SUCCESS)
}

/// Prints one of several results. Breaks with the exit code if the output is closed or fails.
pub(crate) fn print_item(text: &dyn Display) -> ControlFlow<ExitCode> {
    match writeln!(io::stdout(), "{text}") {
        Ok(()) => ControlFlow::Continue(()),
        Err(cause) if cause.kind() == ErrorKind::BrokenPipe => ControlFlow::Break(ExitCode::SUCCESS),
        Err(cause) => {
            ControlFlow::Break(fail_after_result(&format_args!("cannot write to standard output: {cause}"), 1))
        }
    }
}

/// Returns the width of the terminal, columns, or `None` if standard output is not a terminal.
#[cfg_attr(not(feature = "tui"), allow(dead_code, reason = "only terminal views use it"))]
pub(crate) fn terminal_columns() -> Option<usize> {
    let terminal = Term::stdout();
    terminal.is_term().then(|| terminal.size().1.into())
}

/// Prints lines, each truncated to the width of the terminal.
#[cfg_attr(not(feature = "tui"), allow(dead_code, reason = "only terminal views use it"))]
pub(crate) fn print_truncated(text: &str) -> ControlFlow<ExitCode> {
    let columns = terminal_columns().unwrap_or(usize::MAX);
    let cut = |line: &str| line.chars().take(columns).collect::<String>();
    print_item(&text.lines().map(cut).collect::<Vec<_>>().join("\n"))
}
