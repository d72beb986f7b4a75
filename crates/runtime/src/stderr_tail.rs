//! Tail of a child process's standard error, read without blocking the parent.
//!
//! - Input: the standard-error pipe of a child.
//! - Output: the last output of the child, up to [`TAIL_BYTES`].
//! - Time: the parent polls from time to time.
//! - Failure: older output is dropped and counted. Output that cannot be read is left out. A child
//!   that writes more than [`MAX_POLL_BYTES`] between two polls blocks until the next poll.

use std::{collections::VecDeque, io::Read, process::ChildStderr};

use foreign::ForeignText;
use rustix::{io::ioctl_fionbio, pipe::fcntl_setpipe_size};

/// Size of the tail, bytes.
pub const TAIL_BYTES: usize = 8192;
/// Maximum number of bytes read per poll. It is also the size of the pipe if the system permits it.
pub const MAX_POLL_BYTES: usize = 1 << 20;

/// Tail of a child's standard error.
#[derive(Debug, Default)]
pub struct StderrTail {
    pipe: Option<ChildStderr>,
    tail: VecDeque<u8>,
    total_bytes: u64,
}

impl StderrTail {
    /// Creates the tail for the output of `pipe`. If the pipe cannot be made non-blocking, it is
    /// not read.
    pub fn new(pipe: Option<ChildStderr>) -> Self {
        let pipe = pipe.filter(|pipe| ioctl_fionbio(pipe, true).is_ok());
        if let Some(pipe) = &pipe {
            // If the system rejects the request, the pipe keeps its smaller size.
            let _ = fcntl_setpipe_size(pipe, MAX_POLL_BYTES);
        }
        Self { pipe, ..Self::default() }
    }

    /// Returns the pipe, or `None` if the child has closed it.
    pub fn pipe(&self) -> Option<&ChildStderr> {
        self.pipe.as_ref()
    }

    /// Reads what the child has written since the last poll.
    pub fn poll(&mut self) {
        let mut chunk = [0; 16384];
        let mut read_bytes = 0;
        while read_bytes < MAX_POLL_BYTES {
            let Some(pipe) = &mut self.pipe else { return };
            match pipe.read(&mut chunk) {
                Ok(0) => self.pipe = None,
                Ok(count) => {
                    read_bytes += count;
                    self.push(chunk.get(..count).unwrap_or_default());
                }
                // There is no output yet.
                Err(_) => return,
            }
        }
    }

    /// Polls, then returns the tail, with a note if earlier output was dropped.
    pub fn text(&mut self) -> ForeignText {
        self.poll();
        let text = String::from_utf8_lossy(self.tail.make_contiguous()).trim_end().to_owned();
        match self.total_bytes - self.tail.len() as u64 {
            0 => text.into(),
            omitted => format!("({omitted} earlier bytes omitted)\n{text}").into(),
        }
    }

    fn push(&mut self, chunk: &[u8]) {
        self.total_bytes += chunk.len() as u64;
        self.tail.extend(chunk);
        self.tail.drain(..self.tail.len().saturating_sub(TAIL_BYTES));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        process::{Child, Command, Stdio},
        time::Duration,
    };

    fn child(script: &str) -> (Child, StderrTail) {
        let mut child = Command::new("sh").args(["-c", script]).stderr(Stdio::piped()).spawn().unwrap();
        let tail = StderrTail::new(child.stderr.take());
        (child, tail)
    }

    #[test]
    fn ten_megabytes_of_output_keep_only_the_tail() {
        let (mut child, mut tail) = child("head -c 10000000 /dev/zero | tr '\\0' x >&2; echo ' the end' >&2");
        while child.try_wait().unwrap().is_none() {
            tail.poll();
            std::thread::sleep(Duration::from_millis(1));
        }
        let text = tail.text();
        let text = text.raw();
        assert!(text.starts_with("(9991817 earlier bytes omitted)\nxxx") && text.ends_with("xx the end"), "{text}");
        assert_eq!(tail.tail.len(), TAIL_BYTES);
    }

    #[test]
    fn tail_does_not_wait_for_a_living_grandchild() {
        let (mut child, mut tail) = child("sleep 60 & echo $! >&2");
        child.wait().unwrap();
        let text = tail.text();
        let sleeper = text.raw();
        Command::new("kill").arg(sleeper).status().unwrap();
        assert!(sleeper.parse::<u32>().is_ok(), "{sleeper}");
    }

    #[test]
    fn short_output_is_returned_unchanged() {
        let (mut child, mut tail) = child("echo one >&2; echo two >&2");
        child.wait().unwrap();
        assert_eq!(tail.text(), "one\ntwo");
    }
}
