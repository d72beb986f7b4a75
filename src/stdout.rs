//! Standard output.
//!
//! - Failure: a closed pipe, as with `head`, ends the output without an error. While a pipe or
//!   terminal is full, a signal ends the process. If a signal has already ended a run when the
//!   output becomes full, the rest of the output is dropped after a time limit.

use std::{
    fmt::Display,
    io::{self, ErrorKind, Write},
    ops::ControlFlow,
    os::fd::AsFd as _,
    process::ExitCode,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

use console::Term;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};
use serde::Serialize;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    flag::register_conditional_default,
};

/// Number of bytes per write. A pipe that has room accepts this many without blocking (`PIPE_BUF`
/// on Linux).
const CHUNK_BYTES: usize = 4096;
/// Time limit for blocked output after a signal has ended the run.
const STOPPED_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval between two checks for a signal while the output is blocked.
const POLL_INTERVAL: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };

/// Prints the result of a command, or the last of several results, and returns the exit code.
pub(crate) fn print(text: &dyn Display) -> ExitCode {
    print_item(text).break_value().unwrap_or(ExitCode::SUCCESS)
}

/// Prints the result of a command as text or as one JSON object, and returns the exit code.
pub(crate) fn print_result<T: Display + Serialize>(result: &T, json: bool) -> ExitCode {
    // The results contain only numbers, texts, lists and maps with text keys, which can always be
    // serialised.
    if json { print(&serde_json::to_string(result).unwrap_or_default()) } else { print(result) }
}

/// Prints one of several results. Breaks with the exit code if the output is closed or fails.
pub(crate) fn print_item(text: &dyn Display) -> ControlFlow<ExitCode> {
    match write_line(text) {
        Ok(()) => ControlFlow::Continue(()),
        Err(cause) if cause.kind() == ErrorKind::BrokenPipe => ControlFlow::Break(ExitCode::SUCCESS),
        Err(cause) => {
            supervisor::announce(format_args!("cannot write to standard output: {cause}"));
            ControlFlow::Break(ExitCode::FAILURE)
        }
    }
}

/// Writes a line to standard output. While the output is blocked, signals have their default
/// effect, which is to end the process.
pub(crate) fn write_line(text: &dyn Display) -> io::Result<()> {
    let mut stdout = io::stdout();
    for chunk in format!("{text}\n").as_bytes().chunks(CHUNK_BYTES) {
        if !has_room()? {
            restore_default_signals()?;
            let blocked = Instant::now();
            while !has_room()? {
                if supervisor::is_stop_requested() && blocked.elapsed() >= STOPPED_TIMEOUT {
                    return Err(io::Error::new(
                        ErrorKind::TimedOut,
                        "the program that reads standard output has stopped reading",
                    ));
                }
            }
        }
        stdout.write_all(chunk)?;
        stdout.flush()?;
    }
    Ok(())
}

/// Returns `true` once standard output has room for more bytes, or `false` after a short wait.
fn has_room() -> io::Result<bool> {
    let stdout = io::stdout();
    match poll(&mut [PollFd::from_borrowed_fd(stdout.as_fd(), PollFlags::OUT)], Some(&POLL_INTERVAL)) {
        Ok(ready) => Ok(ready > 0),
        Err(Errno::INTR) => Ok(false),
        Err(cause) => Err(cause.into()),
    }
}

/// Restores the default effect of the signals that end a command, even if the command has installed
/// handlers.
fn restore_default_signals() -> io::Result<()> {
    let always = Arc::new(AtomicBool::new(true));
    [SIGTERM, SIGINT, SIGHUP]
        .into_iter()
        .try_for_each(|signal| register_conditional_default(signal, always.clone()).map(drop))
}

/// Returns the width of the terminal in columns, or `None` if standard output is not a terminal.
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
