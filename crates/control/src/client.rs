//! Who asks a running system.

use std::{
    io::{self, BufRead, BufReader, ErrorKind, Read, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    time::Duration,
};

use bus::{BusError, SystemName};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use serde::de::DeserializeOwned;

use crate::{ControlRequest, LINE_MAX, Response, SILENCE_LIMIT, answer_limit};

/// Why a question was not answered, or none can be asked.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The name is none, or another user's.
    #[error(transparent)]
    Name(#[from] BusError),
    /// The socket could not be opened.
    #[error("opening {path}: {cause}")]
    Open {
        /// The socket.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
    /// Nobody is there.
    #[error(
        "asking the system {name:?}: it does not run ({cause}); start it with `plumb up`, or name another with --system"
    )]
    Nobody {
        /// The system.
        name: String,
        /// What the system answered.
        cause: io::Error,
    },
    /// Somebody is there and says nothing.
    #[error(
        "asking the system {name:?}: its supervisor has not answered for {limit_s:.0} s; is it frozen, or has the machine too much to do? `plumb doctor` tells"
    )]
    Silent {
        /// The system.
        name: String,
        /// How long it was waited for.
        limit_s: f64,
    },
    /// It did not answer.
    #[error("asking the system {name:?}: {cause}")]
    Unanswered {
        /// The system.
        name: String,
        /// What is wrong.
        cause: String,
    },
}

/// Asks a running system, and waits for the answer: two seconds, or as long as a swap takes that it has begun, or a shadow.
pub fn ask<A: DeserializeOwned>(name: &str, question: &ControlRequest) -> Result<A, ControlError> {
    let nobody = |cause| ControlError::Nobody { name: name.into(), cause };
    let socket = SystemName::new(name)?.door().map_err(|error| match error {
        BusError::File { cause, .. } => nobody(cause),
        error => ControlError::Name(error),
    })?;
    let unanswered = |cause: String| ControlError::Unanswered { name: name.into(), cause };
    let failed = |limit: Option<Duration>| {
        move |cause: io::Error| match (cause.kind(), limit) {
            (ErrorKind::WouldBlock, Some(limit)) => {
                ControlError::Silent { name: name.into(), limit_s: limit.as_secs_f64() }
            }
            _ => ControlError::Unanswered { name: name.into(), cause: cause.to_string() },
        }
    };
    let mut stream = connect_to(&socket).map_err(|cause| match cause.kind() {
        ErrorKind::WouldBlock => {
            unanswered("too many wait for its answer; is its supervisor frozen? `plumb doctor` tells".into())
        }
        _ => nobody(cause),
    })?;
    let text = serde_json::to_string(question).map_err(|cause| unanswered(cause.to_string()))?;
    stream.set_write_timeout(Some(SILENCE_LIMIT)).map_err(failed(None))?;
    // Whoever is sent away at once may still read why.
    let asked = writeln!(stream, "{text}");
    let mut answers = BufReader::new(stream);
    for limit in [Some(SILENCE_LIMIT), answer_limit(question)] {
        answers.get_ref().set_read_timeout(limit).map_err(failed(None))?;
        let mut line = String::new();
        let count = answers.by_ref().take(LINE_MAX as u64).read_line(&mut line).map_err(failed(limit))?;
        if count == 0 {
            asked.map_err(failed(Some(SILENCE_LIMIT)))?;
            return Err(unanswered("it ended before it had answered; ask again".into()));
        }
        match serde_json::from_str::<Response<A>>(&line).map_err(|cause| unanswered(cause.to_string()))? {
            Response::Taken => {}
            Response::Answer(answer) => return Ok(answer),
            Response::Error(cause) => return Err(unanswered(cause)),
        }
    }
    Err(unanswered("it has taken the question twice".into()))
}

/// A connection to a control socket; `WouldBlock` where its queue is full.
pub(super) fn connect_to(path: &Path) -> io::Result<UnixStream> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(&socket, &SocketAddrUnix::new(path)?)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}
