//! A process of a run: started, heard line by line, ended.

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

/// From the request to end until the process is killed.
const GRACE: Duration = Duration::from_secs(2);

/// A process; it ends when this is dropped.
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
        let (say, lines) = channel();
        thread::spawn(move || BufReader::new(stdout).lines().try_for_each(|line| say.send(line)));
        Ok(Self { child, stdin, lines })
    }

    /// The next line of its standard output, which must come by `deadline`.
    pub(crate) fn line(&mut self, deadline: Instant) -> Result<String, Failure> {
        match self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => Ok(line?),
            Err(RecvTimeoutError::Timeout) => Err(format!("process {} said nothing in time", self.id()).into()),
            Err(RecvTimeoutError::Disconnected) => {
                let said = self.child.stderr.take().map(io::read_to_string).transpose()?.unwrap_or_default();
                Err(format!("process {} ended early: {}", self.id(), said.trim_end()).into())
            }
        }
    }

    /// Its number.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Writes to its standard input and closes that: it may begin.
    pub(crate) fn write_line(&mut self, text: &str) -> Result<(), Failure> {
        Ok(self.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(text.as_bytes()))?)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let deadline = Instant::now() + GRACE;
        if let (Ok(None), Some(pid)) = (self.child.try_wait(), Pid::from_raw(self.child.id() as i32)) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, Signal::TERM);
        }
        while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        // An ended process is only reaped by this; the wait for a killed one is for the kernel only.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
