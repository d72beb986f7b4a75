//! The process of a stage: a request goes out, its answer comes back.

use std::{
    io,
    os::{
        fd::{AsFd, OwnedFd},
        unix::process::CommandExt,
    },
    process::{Child as Process, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use rustix::{
    io::Errno,
    net::{
        AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socketpair,
        sockopt::{Timeout, set_socket_timeout},
    },
};
use sdk::frame::{FRAME_BYTES_MAX, FrameError, Head, Kind};

/// From its start until a program has answered for the first time.
pub const START_LIMIT: Duration = Duration::from_secs(10);
/// How long the status of a program that has closed its end is waited for.
const STATUS_LIMIT: Duration = Duration::from_millis(100);

/// Why a hosted stage cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// There is no such program, or it cannot be run.
    #[error("starting {program}: {cause}")]
    Start {
        /// The command.
        program: String,
        /// What the system answered.
        cause: io::Error,
    },
    /// It has ended.
    #[error("{program} ended with {status} when it was asked to {asked}; what it said is above")]
    Ended {
        /// The command.
        program: String,
        /// How.
        status: String,
        /// What for.
        asked: &'static str,
    },
    /// It did not answer in time.
    #[error("{program} was asked to {asked} and has said nothing for {ms} ms")]
    Silent {
        /// The command.
        program: String,
        /// What for.
        asked: &'static str,
        /// How long.
        ms: u128,
    },
    /// What it answered is no answer.
    #[error("{program} was asked to {asked} and answered with {cause}")]
    Answer {
        /// The command.
        program: String,
        /// What for.
        asked: &'static str,
        /// What is wrong with the answer.
        cause: String,
    },
    /// The stage that this one was to be like has failed.
    #[error("{0}")]
    Like(String),
}

/// A running program and this end of its pair of sockets. It ends with this value.
#[derive(Debug)]
pub(crate) struct Child {
    program: String,
    process: Process,
    socket: OwnedFd,
    /// Requests so far.
    number: u64,
    request: Vec<u8>,
    answer: Vec<u8>,
    limit: Duration,
}

impl Child {
    /// Starts the program; it has [`START_LIMIT`] for each answer until another limit is set.
    pub(crate) fn start(mut command: Command) -> Result<Self, HostError> {
        let words = [command.get_program()].into_iter().chain(command.get_args());
        let program = words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ");
        let failed = |cause: io::Error| HostError::Start { program: program.clone(), cause };
        let (socket, its) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
            .map_err(|errno| failed(errno.into()))?;
        // What it prints is for people; frames are all that goes over its standard input.
        let stdout = io::stderr().as_fd().try_clone_to_owned().map_err(failed)?;
        command.stdin(its).stdout(stdout).stderr(Stdio::inherit());
        // Ctrl-C is for whoever hosts it.
        let process = command.process_group(0).spawn().map_err(failed)?;
        drop(command);
        let answer = vec![0; FRAME_BYTES_MAX];
        let mut child =
            Self { program, process, socket, number: 0, request: Vec::new(), answer, limit: Duration::ZERO };
        child.set_limit(START_LIMIT)?;
        Ok(child)
    }

    /// The process.
    pub(crate) fn pid(&self) -> u32 {
        self.process.id()
    }

    /// How long each answer may take from now on.
    pub(crate) fn set_limit(&mut self, limit: Duration) -> Result<(), HostError> {
        self.limit = limit;
        set_socket_timeout(&self.socket, Timeout::Recv, Some(limit))
            .map_err(|errno| HostError::Start { program: self.program.clone(), cause: errno.into() })
    }

    /// Asks, and waits for the answer; `None` where it refuses.
    pub(crate) fn ask(&mut self, kind: Kind, put: impl FnOnce(&mut Vec<u8>)) -> Result<Option<&[u8]>, HostError> {
        self.number += 1;
        Head { kind, refused: false, number: self.number }.begin(&mut self.request);
        put(&mut self.request);
        if send(&self.socket, &self.request, SendFlags::NOSIGNAL).is_err() {
            return Err(self.ended(kind));
        }
        let len = self.receive(kind)?;
        let wrong = |program: &str, cause: FrameError| HostError::Answer {
            program: program.into(),
            asked: asked(kind),
            cause: cause.to_string(),
        };
        let (head, payload) =
            Head::of(self.answer.get(..len).unwrap_or_default()).map_err(|e| wrong(&self.program, e))?;
        if (head.kind, head.number) != (kind, self.number) {
            let other = FrameError::Other { found: head.number, kind: head.kind, expected: self.number };
            return Err(wrong(&self.program, other));
        }
        Ok((!head.refused).then_some(payload))
    }

    /// What the program answered is no answer to that.
    pub(crate) fn wrong(&self, kind: Kind, cause: &dyn std::fmt::Display) -> HostError {
        HostError::Answer { program: self.program.clone(), asked: asked(kind), cause: cause.to_string() }
    }

    /// Bytes of the next packet.
    fn receive(&mut self, kind: Kind) -> Result<usize, HostError> {
        let begun = Instant::now();
        loop {
            match recv(&self.socket, &mut self.answer[..], RecvFlags::empty()) {
                Ok((len, _)) if len > 0 => return Ok(len),
                // A signal of this process's own, which is not heeded here.
                Err(Errno::INTR) if begun.elapsed() < self.limit => {}
                Err(Errno::AGAIN | Errno::INTR) => {
                    let ms = begun.elapsed().as_millis();
                    return Err(HostError::Silent { program: self.program.clone(), asked: asked(kind), ms });
                }
                Ok(_) | Err(_) => return Err(self.ended(kind)),
            }
        }
    }

    /// How it ended; it may close its end a moment before.
    fn ended(&mut self, kind: Kind) -> HostError {
        let begun = Instant::now();
        let status: Option<ExitStatus> = loop {
            match self.process.try_wait() {
                Ok(None) if begun.elapsed() < STATUS_LIMIT => std::thread::sleep(Duration::from_millis(1)),
                status => break status.ok().flatten(),
            }
        };
        let status = status.map_or("a closed standard input".into(), |status| status.to_string());
        HostError::Ended { program: self.program.clone(), status, asked: asked(kind) }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // It has nothing to keep: its state is asked for. A process that has ended already is only waited for.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What a request asks for, for people.
fn asked(kind: Kind) -> &'static str {
    match kind {
        Kind::Describe => "describe itself",
        Kind::Set => "take a parameter",
        Kind::Step => "step",
        Kind::Snapshot => "tell its state",
        Kind::Restore => "take a state over",
        Kind::Common => "tell what others can go on with",
        Kind::Adopt => "go on from another stage",
        Kind::Align => "align",
        Kind::Realign => "realign",
    }
}
