//! Standard error, where people read: a pipe or terminal that nobody empties may be full.
//!
//! Input: lines. Output: what is taken of them. Time: the wait for room, which may have a limit. Failure: what nobody takes by then is left
//! out; who has closed the other end reads nothing.

use std::{
    fmt::Display,
    io::{self, Write as _},
    os::fd::AsFd as _,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};

/// How long a line waits for room.
pub(crate) const LIMIT: Option<Timespec> = Some(Timespec { tv_sec: 1, tv_nsec: 0 });
/// A line waits until somebody takes it.
pub(crate) const NO_LIMIT: Option<Timespec> = None;
/// A pipe that has room takes as many bytes at once (`PIPE_BUF` of Linux), so that no write waits.
const PIECE: usize = 4096;

/// Prints a line as far as it is taken, a piece at a time, each within the limit.
pub(crate) fn say(line: impl Display, limit: Option<Timespec>) {
    for piece in format!("{line}\n").as_bytes().chunks(PIECE) {
        if !has_room(limit.as_ref()) || io::stderr().write_all(piece).is_err() {
            return;
        }
    }
}

fn has_room(limit: Option<&Timespec>) -> bool {
    loop {
        let stderr = io::stderr();
        match poll(&mut [PollFd::from_borrowed_fd(stderr.as_fd(), PollFlags::OUT)], limit) {
            Err(Errno::INTR) => {}
            Ok(0) => return false,
            // The write tells of every other failure.
            _ => return true,
        }
    }
}
