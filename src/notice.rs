//! Messages on standard error, and their settings: `--quiet` and `--color`.

use std::{
    fmt::Display,
    sync::atomic::{AtomicBool, Ordering},
};

use clap::ColorChoice;
use console::{Color, Style, Term};
use indicatif::{ProgressBar, ProgressStyle};
use textwrap::Options;

/// Words that state the result of a check at the start of a line, with their colours.
const RESULTS: [(&str, Color); 4] =
    [("ok", Color::Green), ("warning", Color::Yellow), ("PROBLEM", Color::Red), ("FAILED", Color::Red)];

/// `true` if progress and confirmations are not printed.
static IS_QUIET: AtomicBool = AtomicBool::new(false);

/// Applies the settings of the command line to this process.
pub(crate) fn configure(color: ColorChoice, quiet: bool) {
    IS_QUIET.store(quiet, Ordering::Relaxed);
    let has_color = match color {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        // A variable that is not empty disables colours, see https://no-color.org.
        ColorChoice::Auto if std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty()) => false,
        ColorChoice::Auto => return,
    };
    console::set_colors_enabled(has_color);
    console::set_colors_enabled_stderr(has_color);
}

/// Returns `true` if `--quiet` was given.
pub(crate) fn is_quiet() -> bool {
    IS_QUIET.load(Ordering::Relaxed)
}

/// Prints a confirmation, which `--quiet` suppresses. Warnings and errors are always printed, by
/// [`supervisor::announce`].
pub(crate) fn notice(line: impl Display) {
    if !is_quiet() {
        supervisor::announce(line);
    }
}

/// Returns a progress bar, which is hidden by `--quiet` and if standard error is not a terminal.
pub(crate) fn progress_bar(length: u64, template: &str) -> ProgressBar {
    let bar = if is_quiet() { ProgressBar::hidden() } else { ProgressBar::new(length) };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style)
}

/// Returns the lines with the result of each check in colour, if standard output shows colours.
///
/// On a terminal, long lines continue below column `indent`.
pub(crate) fn colored_results(lines: &dyn Display, indent: usize) -> String {
    let lines = wrapped(&lines.to_string(), indent);
    let colored = lines.lines().map(|line| {
        let text = line.trim_start();
        let result = RESULTS.iter().find(|(word, _)| text.split(' ').next() == Some(word));
        match result {
            Some((word, color)) => {
                let (indentation, rest) = (&line[..line.len() - text.len()], &text[word.len()..]);
                format!("{indentation}{}{rest}", Style::new().fg(*color).bold().apply_to(word))
            }
            None => line.to_owned(),
        }
    });
    colored.collect::<Vec<_>>().join("\n")
}

/// Wraps lines at the width of the terminal. Remedies are not wrapped, because users copy and paste
/// the commands in them. Text that is not for a terminal is unchanged.
fn wrapped(text: &str, indent: usize) -> String {
    let terminal = Term::stdout();
    if !terminal.is_term() {
        return text.to_owned();
    }
    let indent = " ".repeat(indent);
    let options = Options::new(terminal.size().1.into()).subsequent_indent(&indent).break_words(false);
    let fill = |line: &str| match line.trim_start().starts_with('→') {
        true => line.to_owned(),
        false => textwrap::fill(line, &options),
    };
    text.lines().map(fill).collect::<Vec<_>>().join("\n")
}
