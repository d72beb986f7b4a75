//! Writes to standard error without blocking on a pipe or terminal that is not drained.
//!
//! - Input: lines.
//! - Output: the lines, as far as they are accepted.
//! - Time: waits for the output to accept more, with an optional timeout.
//! - Failure: a line is dropped if it is not accepted in time or if standard error is closed.

use std::{
    fmt::Display,
    io::{self, Write as _},
    os::fd::AsFd,
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};

/// Time limit for a pipe or terminal to accept more output.
pub(crate) const WRITE_TIMEOUT: Option<Duration> = Some(Duration::from_secs(1));
/// No time limit: waits until the output is accepted.
pub(crate) const NO_TIMEOUT: Option<Duration> = None;
/// Number of bytes per write. A pipe that has room accepts this many without blocking (`PIPE_BUF`
/// on Linux).
const CHUNK_BYTES: usize = 4096;

/// Writes a line in chunks, each within the timeout. Drops the remaining chunks after a failure.
pub(crate) fn write_line(line: impl Display, timeout: Option<Duration>) {
    for chunk in format!("{line}\n").as_bytes().chunks(CHUNK_BYTES) {
        if !has_room(&io::stderr(), timeout) || io::stderr().write_all(chunk).is_err() {
            return;
        }
    }
}

/// Waits until `output` accepts more. Returns `false` if it does not within the timeout.
fn has_room(output: &impl AsFd, timeout: Option<Duration>) -> bool {
    let deadline = timeout.map(|timeout| Instant::now() + timeout);
    loop {
        // A signal must not extend the wait.
        let remaining = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        let remaining =
            remaining.map(|rest| Timespec { tv_sec: rest.as_secs() as i64, tv_nsec: i64::from(rest.subsec_nanos()) });
        match poll(&mut [PollFd::new(output, PollFlags::OUT)], remaining.as_ref()) {
            Err(Errno::INTR) => {}
            Ok(0) => return false,
            // The output is ready, is closed or has failed. If it has failed, the write that
            // follows reports the failure.
            _ => return true,
        }
    }
}

/// Prints a line to standard error.
///
/// The line is dropped if standard error is closed or stays blocked for 1 s, so that a blocked
/// terminal does not stop the system.
pub fn announce(line: impl std::fmt::Display) {
    write_line(line, WRITE_TIMEOUT);
}
