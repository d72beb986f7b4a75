//! What a process says on standard error, heard without a wait on either side.
//!
//! Input: the pipe of a child. Output: the last words, up to [`KEPT_BYTES`]. Time: none; whoever started the child listens from time to
//! time. Failure: what is older is left out and counted; what cannot be read is not shown. A child that says more than
//! [`HEARD_BYTES`] between two times has to wait for the next, and is heard again.

use std::{collections::VecDeque, io::Read, process::ChildStderr};

use rustix::{io::ioctl_fionbio, pipe::fcntl_setpipe_size};

/// Last words, bytes.
pub const KEPT_BYTES: usize = 8192;
/// Most that is heard at a time, and what the pipe holds in between where the system allows it, bytes.
pub const HEARD_BYTES: usize = 1 << 20;

/// Standard error of a child.
#[derive(Debug, Default)]
pub struct StderrTail {
    pipe: Option<ChildStderr>,
    last: VecDeque<u8>,
    bytes: u64,
}

impl StderrTail {
    /// Listens to this pipe; one that cannot be read without a wait is not read.
    pub fn on(pipe: Option<ChildStderr>) -> Self {
        let pipe = pipe.filter(|pipe| ioctl_fionbio(pipe, true).is_ok());
        if let Some(pipe) = &pipe {
            // A system that does not allow it has a smaller pipe.
            let _ = fcntl_setpipe_size(pipe, HEARD_BYTES);
        }
        Self { pipe, ..Self::default() }
    }

    /// Takes what has been said since the last time.
    pub fn listen(&mut self) {
        let mut part = [0; 16384];
        let mut heard = 0;
        while heard < HEARD_BYTES {
            let Some(pipe) = &mut self.pipe else { return };
            match pipe.read(&mut part) {
                Ok(0) => self.pipe = None,
                Ok(count) => {
                    heard += count;
                    self.keep(part.get(..count).unwrap_or_default());
                }
                // Nothing more as yet, or nothing more at all, which the next time shows.
                Err(_) => return,
            }
        }
    }

    /// The last words.
    pub fn text(&mut self) -> String {
        self.listen();
        let text = String::from_utf8_lossy(self.last.make_contiguous()).trim_end().to_owned();
        match self.bytes - self.last.len() as u64 {
            0 => text,
            left_out => format!("({left_out} bytes are left out)\n{text}"),
        }
    }

    fn keep(&mut self, part: &[u8]) {
        self.bytes += part.len() as u64;
        self.last.extend(part);
        self.last.drain(..self.last.len().saturating_sub(KEPT_BYTES));
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
        let said = StderrTail::on(child.stderr.take());
        (child, said)
    }

    #[test]
    fn a_child_that_says_ten_megabytes_ends_and_its_last_words_are_kept() {
        let (mut child, mut said) = child("head -c 10000000 /dev/zero | tr '\\0' x >&2; echo ' the end' >&2");
        while child.try_wait().unwrap().is_none() {
            said.listen();
            std::thread::sleep(Duration::from_millis(1));
        }
        let text = said.text();
        assert!(text.starts_with("(9991817 bytes are left out)\nxxx") && text.ends_with("xx the end"), "{text}");
        assert_eq!(said.last.len(), KEPT_BYTES);
    }

    #[test]
    fn the_words_of_a_child_whose_own_child_lives_on_are_not_waited_for() {
        let (mut child, mut said) = child("sleep 60 & echo $! >&2");
        child.wait().unwrap();
        let sleeper = said.text();
        Command::new("kill").arg(&sleeper).status().unwrap();
        assert!(sleeper.parse::<u32>().is_ok(), "{sleeper}");
    }

    #[test]
    fn little_is_told_as_it_was_said() {
        let (mut child, mut said) = child("echo one >&2; echo two >&2");
        child.wait().unwrap();
        assert_eq!(said.text(), "one\ntwo");
    }
}
