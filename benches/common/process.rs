//! Child process of a benchmark. Its output is read line by line.

use std::{
    ffi::OsStr,
    io::{self, BufRead, BufReader, Write},
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};

use crate::Failure;

/// Time allowed after the termination signal, before the process is killed.
const TERMINATION_TIMEOUT: Duration = Duration::from_secs(2);

/// Child process, terminated on drop.
pub(crate) struct Process {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<io::Result<String>>,
}

impl Process {
    pub(crate) fn start<'a>(program: &OsStr, args: impl IntoIterator<Item = &'a str>) -> Result<Self, Failure> {
        let mut command = Command::new(program);
        command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|cause| format!("starting {}: {cause}", program.display()))?;
        let stdin = child.stdin.take();
        let stdout = child.stdout.take().expect("standard output is a pipe");
        let (sender, lines) = channel();
        thread::spawn(move || BufReader::new(stdout).lines().try_for_each(|line| sender.send(line)));
        Ok(Self { child, stdin, lines })
    }

    /// Returns the next line of standard output.
    ///
    /// # Errors
    ///
    /// Returns an error if no line arrives before `deadline` or the process has ended.
    pub(crate) fn line(&mut self, deadline: Instant) -> Result<String, Failure> {
        match self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => Ok(line?),
            Err(RecvTimeoutError::Timeout) => Err(format!("process {} printed no line in time", self.id()).into()),
            Err(RecvTimeoutError::Disconnected) => {
                let stderr = self.child.stderr.take().map(io::read_to_string).transpose()?.unwrap_or_default();
                Err(format!("process {} ended early: {}", self.id(), stderr.trim_end()).into())
            }
        }
    }

    /// Returns the process identifier.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Writes `text` to standard input and closes it. Further calls have no effect.
    pub(crate) fn write_input(&mut self, text: &str) -> Result<(), Failure> {
        Ok(self.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(text.as_bytes()))?)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let deadline = Instant::now() + TERMINATION_TIMEOUT;
        if let (Ok(None), Some(pid)) = (self.child.try_wait(), Pid::from_raw(self.child.id() as i32)) {
            // If the process has just ended, the signal is not needed.
            let _ = kill_process(pid, Signal::TERM);
        }
        while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        // `kill` does nothing if the process has ended. After `kill`, the process ends at once, so
        // `wait` needs no time limit.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
