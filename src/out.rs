//! Standard output: results.
//!
//! Whoever reads may close it when that is enough, as `head` does: nothing more is printed then, and nobody complains.

use std::{
    fmt::Display,
    io::{self, ErrorKind, Write},
    ops::ControlFlow,
    process::ExitCode,
};

use console::Term;

use crate::fail_after_result;

/// Prints the result of a command, which ends with it.
pub(crate) fn print(text: &dyn Display) -> ExitCode {
    show(text).break_value().unwrap_or(ExitCode::SUCCESS)
}

/// Prints one result of several; breaks, with what the command ends with, where nobody reads on.
pub(crate) fn show(text: &dyn Display) -> ControlFlow<ExitCode> {
    match writeln!(io::stdout(), "{text}") {
        Ok(()) => ControlFlow::Continue(()),
        Err(cause) if cause.kind() == ErrorKind::BrokenPipe => ControlFlow::Break(ExitCode::SUCCESS),
        Err(cause) => ControlFlow::Break(fail_after_result(&format_args!("printing the result: {cause}"), 1)),
    }
}

/// Prints `{"error": …}` where a script asked for an object: it gets one of a command that failed, too.
pub(crate) fn error_object(error: &dyn Display) {
    if std::env::args_os().any(|argument| argument == "--json") {
        // Where nobody reads any more, the exit code still tells.
        let _ = writeln!(io::stdout(), "{}", serde_json::json!({ "error": error.to_string().trim_end() }));
    }
}

/// The columns of the terminal that standard output is, if it is one.
pub(crate) fn columns() -> Option<usize> {
    let terminal = Term::stdout();
    terminal.is_term().then(|| terminal.size().1.into())
}

/// Prints lines, of which a terminal gets what fits into its width.
pub(crate) fn show_lines(text: &str) -> ControlFlow<ExitCode> {
    let columns = columns().unwrap_or(usize::MAX);
    let cut = |line: &str| line.chars().take(columns).collect::<String>();
    show(&text.lines().map(cut).collect::<Vec<_>>().join("\n"))
}
