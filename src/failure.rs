//! Reports of a failed command, and its exit code.

use std::{fmt::Display, process::ExitCode};

use crate::stdout::write_line;

/// Reports the failure of a command that has not printed a result.
pub(crate) fn fail(error: &dyn Display, code: u8) -> ExitCode {
    print_error_object(error);
    fail_after_result(error, code)
}

/// Reports the error of a command that has already printed its result.
pub(crate) fn fail_after_result(error: &dyn Display, code: u8) -> ExitCode {
    supervisor::announce(error);
    ExitCode::from(code)
}

/// Prints `{"error": …}` if `--json` was given, so that scripts always get an object.
pub(crate) fn print_error_object(error: &dyn Display) {
    if std::env::args_os().any(|argument| argument == "--json") {
        // If the output is closed, the exit code still reports the failure.
        let _ = write_line(&serde_json::json!({ "error": error.to_string().trim_end() }));
    }
}
