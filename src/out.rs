//! Standard output: results, and a picture that is drawn anew from time to time.
//!
//! Whoever reads may close it when that is enough, as `head` does: nothing more is printed then, and nobody complains.

use std::{
    fmt::Display,
    io::{self, ErrorKind, Write},
    ops::ControlFlow,
    process::ExitCode,
};

use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

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

/// Where a picture is shown: on a terminal each in the place of the one before, else below it.
pub(crate) struct Screen {
    terminal: Term,
    place: Option<ProgressBar>,
}

impl Screen {
    /// Standard output; `in_place` allows a terminal to be drawn anew.
    pub(crate) fn new(in_place: bool) -> Self {
        let terminal = Term::stdout();
        let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        let place = (in_place && terminal.is_term())
            .then(|| ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout()).with_style(style));
        Self { terminal, place }
    }

    /// Shows the next picture, for so many columns where it is a terminal; what is wider all the same is cut off.
    pub(crate) fn show(&self, picture: &dyn Fn(Option<usize>) -> String) -> ControlFlow<ExitCode> {
        let columns = self.terminal.is_term().then(|| self.terminal.size().1.into());
        let cut = |line: &str| line.chars().take(columns.unwrap_or(usize::MAX)).collect::<String>();
        let text = picture(columns).lines().map(cut).collect::<Vec<_>>().join("\n");
        match &self.place {
            Some(place) => {
                place.set_message(text);
                ControlFlow::Continue(())
            }
            None => show(&text),
        }
    }
}

impl Drop for Screen {
    /// The last picture stays.
    fn drop(&mut self) {
        self.place.iter().for_each(ProgressBar::abandon);
    }
}
