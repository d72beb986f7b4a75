//! Writes to standard error without blocking on a pipe or terminal that is not drained.
//!
//! - Input: lines.
//! - Output: the lines, as far as they are accepted.
//! - Time: waits for the output to accept more, with an optional timeout.
//! - Failure: a line is dropped if it is not accepted in time or if standard error is closed.

use std::{
    fmt::Display,
    io::{self, Write as _},
    os::fd::AsFd as _,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};

/// Time limit for a pipe or terminal to accept more output.
pub(crate) const WRITE_TIMEOUT: Option<Timespec> = Some(Timespec { tv_sec: 1, tv_nsec: 0 });
/// No time limit: waits until the output is accepted.
pub(crate) const NO_TIMEOUT: Option<Timespec> = None;
/// Number of bytes per write. A pipe that has room accepts this many without blocking (`PIPE_BUF`
/// on Linux).
const CHUNK_BYTES: usize = 4096;

/// Writes a line in chunks, each within the timeout. Drops the remaining chunks after a failure.
pub(crate) fn write_line(line: impl Display, timeout: Option<Timespec>) {
    for chunk in format!("{line}\n").as_bytes().chunks(CHUNK_BYTES) {
        if !has_room(timeout.as_ref()) || io::stderr().write_all(chunk).is_err() {
            return;
        }
    }
}

fn has_room(timeout: Option<&Timespec>) -> bool {
    loop {
        let stderr = io::stderr();
        match poll(&mut [PollFd::from_borrowed_fd(stderr.as_fd(), PollFlags::OUT)], timeout) {
            Err(Errno::INTR) => {}
            Ok(0) => return false,
            // Standard error is ready, is closed or has failed. If it has failed, the write that
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
