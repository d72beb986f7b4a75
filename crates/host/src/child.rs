//! Process of an external stage, which sends one response per request.

use std::{
    io,
    os::{
        fd::OwnedFd,
        unix::process::{CommandExt, ExitStatusExt},
    },
    process::{Child as Process, Command, ExitStatus},
    time::{Duration, Instant},
};

use foreign::ForeignText;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    net::{AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socketpair},
    process::{Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, kill_process_group, pidfd_open, waitid},
};
use sdk::frame::{FrameError, FrameHeader, MAX_FRAME_BYTES, RequestKind};

use crate::stage_output::StageOutput;

/// Timeout for each response during the start of a program.
pub const START_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for the exit status of a program that has closed its end of the connection.
const EXIT_STATUS_TIMEOUT: Duration = Duration::from_millis(100);

/// Remedy for a program that does not respond during its start.
const START_REMEDY: &str = "check that it responds to its first request";
/// Remedy for a program that has responded before. The timeout of its responses is a share of
/// `silence_s`.
const RUN_REMEDY: &str = "if it is slow, raise silence_s in [restart] of the launch file";
/// Time allowed for a program to exit after SIGTERM before its process group is killed.
const TERMINATE_TIMEOUT: Duration = Duration::from_millis(100);
/// Interval between two checks for the exit of a program.
const EXIT_POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Failure of an external stage.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// The program does not exist or cannot be executed.
    #[error("starting {program}: {cause}")]
    Start {
        /// Command line of the program.
        program: ForeignText,
        /// Operating system error.
        cause: io::Error,
    },
    /// The program exited.
    #[error("{program} ended with {status} on the request to {request}; its output is above")]
    Exited {
        /// Command line of the program.
        program: ForeignText,
        /// Exit status, or a description if it is unknown.
        status: String,
        /// Pending request.
        request: &'static str,
    },
    /// The program did not respond in time.
    #[error("{program} has not responded to the request to {request} for {waited_ms} ms; {remedy}")]
    Timeout {
        /// Command line of the program.
        program: ForeignText,
        /// Pending request.
        request: &'static str,
        /// Time waited, ms.
        waited_ms: u128,
        /// Suggested action.
        remedy: &'static str,
    },
    /// The response is invalid.
    #[error("{program} sent an invalid response to the request to {request}: {cause}")]
    InvalidResponse {
        /// Command line of the program.
        program: ForeignText,
        /// Request that was answered.
        request: &'static str,
        /// Error in the response.
        cause: ForeignText,
    },
    /// The stage could not be cloned, or the original had already failed.
    #[error("{0}")]
    CloneFailed(String),
}

/// Running program and the host's end of the socket pair.
///
/// Dropping it ends the program and its process group, which contains the processes that the
/// program has started.
#[derive(Debug)]
pub(crate) struct Child {
    program: ForeignText,
    process: Process,
    /// Descriptor that becomes readable when the program exits, even if another process that the
    /// program has started keeps the socket open. `None` if the kernel does not support such
    /// descriptors.
    exit: Option<OwnedFd>,
    output: StageOutput,
    socket: OwnedFd,
    /// Number of requests so far.
    number: u64,
    frame: Vec<u8>,
    response: Vec<u8>,
    timeout: Duration,
    /// Suggested action if the program does not respond.
    timeout_remedy: &'static str,
}

impl Child {
    /// Starts the program. The timeout of a response is [`START_TIMEOUT`] until it is changed.
    pub(crate) fn start(mut command: Command) -> Result<Self, HostError> {
        let words = [command.get_program()].into_iter().chain(command.get_args());
        let program = words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ");
        let program = ForeignText::from(program);
        let failed = |cause: io::Error| HostError::Start { program: program.clone(), cause };
        let (socket, child_socket) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
            .map_err(|errno| failed(errno.into()))?;
        // Both standard output and standard error are printed on the host's standard error.
        // Standard input is the socket and carries only frames.
        let (output, pipe) = StageOutput::start().map_err(failed)?;
        command.stdin(child_socket).stdout(pipe.try_clone().map_err(failed)?).stderr(pipe);
        // The program has its own process group, so that Ctrl-C reaches only the host and the whole
        // group can be ended.
        let process = command.process_group(0).spawn().map_err(failed)?;
        drop(command);
        let exit = Pid::from_raw(process.id() as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        Ok(Self {
            program,
            process,
            exit,
            output,
            socket,
            number: 0,
            frame: Vec::new(),
            response: vec![0; MAX_FRAME_BYTES],
            timeout: START_TIMEOUT,
            timeout_remedy: START_REMEDY,
        })
    }

    /// Returns the process identifier.
    pub(crate) fn pid(&self) -> u32 {
        self.process.id()
    }

    /// Sets the timeout for each response after the start.
    pub(crate) fn set_response_timeout(&mut self, timeout: Duration) {
        (self.timeout, self.timeout_remedy) = (timeout, RUN_REMEDY);
    }

    /// Sends a request and returns the payload of the response, or `None` if the program rejects
    /// the request.
    pub(crate) fn request(
        &mut self,
        kind: RequestKind,
        write: impl FnOnce(&mut Vec<u8>),
    ) -> Result<Option<&[u8]>, HostError> {
        self.number += 1;
        FrameHeader { kind, rejected: false, request_number: self.number }.start_frame(&mut self.frame);
        write(&mut self.frame);
        if send(&self.socket, &self.frame, SendFlags::NOSIGNAL).is_err() {
            return Err(self.ended(kind));
        }
        let len = self.receive(kind)?;
        let invalid = |program: &ForeignText, cause: FrameError| HostError::InvalidResponse {
            program: program.clone(),
            request: request_name(kind),
            cause: cause.to_string().into(),
        };
        let (head, payload) =
            FrameHeader::parse(self.response.get(..len).unwrap_or_default()).map_err(|e| invalid(&self.program, e))?;
        if (head.kind, head.request_number) != (kind, self.number) {
            let mismatch =
                FrameError::RequestMismatch { found: head.request_number, kind: head.kind, expected: self.number };
            return Err(invalid(&self.program, mismatch));
        }
        Ok((!head.rejected).then_some(payload))
    }

    /// Builds the error for an invalid response to a request.
    pub(crate) fn invalid_response(&self, kind: RequestKind, cause: &dyn std::fmt::Display) -> HostError {
        HostError::InvalidResponse {
            program: self.program.clone(),
            request: request_name(kind),
            cause: cause.to_string().into(),
        }
    }

    /// Receives the next packet and returns its length.
    fn receive(&mut self, kind: RequestKind) -> Result<usize, HostError> {
        let started = Instant::now();
        loop {
            let left = self.timeout.saturating_sub(started.elapsed());
            let has_exited = self.wait_for_packet(left);
            match recv(&self.socket, &mut self.response[..], RecvFlags::DONTWAIT) {
                Ok((len, _)) if len > 0 => return Ok(len),
                Err(Errno::AGAIN | Errno::INTR) if !has_exited && !left.is_zero() => {}
                Err(Errno::AGAIN | Errno::INTR) if !has_exited => {
                    let waited_ms = started.elapsed().as_millis();
                    return Err(HostError::Timeout {
                        program: self.program.clone(),
                        request: request_name(kind),
                        waited_ms,
                        remedy: self.timeout_remedy,
                    });
                }
                Ok(_) | Err(_) => return Err(self.ended(kind)),
            }
        }
    }

    /// Waits until a packet arrives, the program exits or the time `left` has elapsed. Returns
    /// `true` if the program has exited.
    fn wait_for_packet(&self, left: Duration) -> bool {
        let mut fds =
            [&self.socket, self.exit.as_ref().unwrap_or(&self.socket)].map(|fd| PollFd::new(fd, PollFlags::IN));
        let count = if self.exit.is_some() { 2 } else { 1 };
        // Waiting can be interrupted by a signal to this process, which is handled elsewhere.
        let _ = poll(&mut fds[..count], Timespec::try_from(left).ok().as_ref());
        let [_, exit] = &fds;
        !exit.revents().is_empty()
    }

    /// Builds the error for a closed connection. Waits briefly for the exit status.
    fn ended(&mut self, kind: RequestKind) -> HostError {
        let status = self.wait_for_exit(EXIT_STATUS_TIMEOUT);
        self.output.wait(EXIT_STATUS_TIMEOUT);
        let status = status.map_or("its standard input closed".into(), |status| status.to_string());
        HostError::Exited { program: self.program.clone(), status, request: request_name(kind) }
    }
}

impl Child {
    /// Waits for the exit of the program and returns its status, or `None` on a timeout.
    ///
    /// The process is not reaped, so that no other process group can get its identifier.
    fn wait_for_exit(&self, timeout: Duration) -> Option<ExitStatus> {
        let id = WaitId::Pid(Pid::from_raw(self.process.id() as i32)?);
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let started = Instant::now();
        loop {
            if let Ok(Some(status)) = waitid(id.clone(), options) {
                let raw = status.exit_status().map(|code| code << 8).or(status.terminating_signal())?;
                return Some(ExitStatus::from_raw(raw));
            }
            if started.elapsed() >= timeout {
                return None;
            }
            std::thread::sleep(EXIT_POLL_INTERVAL);
        }
    }

    /// Sends a signal to the program and to the processes that it has started.
    fn signal_group(&self, signal: Signal) {
        if let Some(group) = Pid::from_raw(self.process.id() as i32) {
            // An error means that every process of the group has exited.
            let _ = kill_process_group(group, signal);
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        self.signal_group(Signal::TERM);
        self.wait_for_exit(TERMINATE_TIMEOUT);
        // The group is killed even if the program has exited, because the processes that it has
        // started may remain.
        self.signal_group(Signal::KILL);
        // The process has been killed, so this waits only for the kernel.
        let _ = self.process.wait();
        self.output.wait(TERMINATE_TIMEOUT);
    }
}

/// Describes a request, for error messages.
fn request_name(kind: RequestKind) -> &'static str {
    match kind {
        RequestKind::Describe => "describe itself",
        RequestKind::Set => "set a parameter",
        RequestKind::Step => "step",
        RequestKind::Snapshot => "report its state",
        RequestKind::Restore => "restore a state",
        RequestKind::Common => "report its common state",
        RequestKind::Adopt => "adopt a common state",
        RequestKind::Align => "align",
        RequestKind::Realign => "realign",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_command_line_is_escaped() {
        let error = Child::start(Command::new("/nowhere\x1b[2J\nforged")).unwrap_err().to_string();
        assert!(error.starts_with(r"starting /nowhere\u{1b}[2J\nforged: "), "{error:?}");
    }
}
