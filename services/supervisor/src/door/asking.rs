//! Who asks a running system.

use std::{
    io::{self, BufRead, BufReader, ErrorKind, Read, Write},
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

use bus::{BusError, Domain};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use serde::de::DeserializeOwned;

use super::{Ask, LINE_MAX, SILENCE_LIMIT, Said};

/// Why a question was not answered.
#[derive(Debug, thiserror::Error)]
pub enum DoorError {
    /// The name is none, or another user's.
    #[error(transparent)]
    Name(#[from] BusError),
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
pub fn ask<A: DeserializeOwned>(name: &str, question: &Ask) -> Result<A, DoorError> {
    let nobody = |cause| DoorError::Nobody { name: name.into(), cause };
    let door = Domain::new(name)?.door().map_err(|error| match error {
        BusError::File { cause, .. } => nobody(cause),
        error => DoorError::Name(error),
    })?;
    let unanswered = |cause: String| DoorError::Unanswered { name: name.into(), cause };
    let failed = |limit: Option<Duration>| {
        move |cause: io::Error| match (cause.kind(), limit) {
            (ErrorKind::WouldBlock, Some(limit)) => {
                DoorError::Silent { name: name.into(), limit_s: limit.as_secs_f64() }
            }
            _ => DoorError::Unanswered { name: name.into(), cause: cause.to_string() },
        }
    };
    let mut stream = knock(&door).map_err(|cause| match cause.kind() {
        ErrorKind::WouldBlock => {
            unanswered("too many wait at its door; is its supervisor frozen? `plumb doctor` tells".into())
        }
        _ => nobody(cause),
    })?;
    let text = serde_json::to_string(question).map_err(|cause| unanswered(cause.to_string()))?;
    stream.set_write_timeout(Some(SILENCE_LIMIT)).map_err(failed(None))?;
    // Whoever is sent away at once may still read why.
    let asked = writeln!(stream, "{text}");
    let mut answers = BufReader::new(stream);
    for limit in [Some(SILENCE_LIMIT), question.answer_limit()] {
        answers.get_ref().set_read_timeout(limit).map_err(failed(None))?;
        let mut line = String::new();
        let count = answers.by_ref().take(LINE_MAX as u64).read_line(&mut line).map_err(failed(limit))?;
        if count == 0 {
            asked.map_err(failed(Some(SILENCE_LIMIT)))?;
            return Err(unanswered("it ended before it had answered; ask again".into()));
        }
        match serde_json::from_str::<Said<A>>(&line).map_err(|cause| unanswered(cause.to_string()))? {
            Said::Taken => {}
            Said::Answer(answer) => return Ok(answer),
            Said::Error(cause) => return Err(unanswered(cause)),
        }
    }
    Err(unanswered("it has taken the question twice".into()))
}

/// A connection to a door; `WouldBlock` where so many wait there that this one would have to wait to be let wait.
pub(super) fn knock(door: &Path) -> io::Result<UnixStream> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(&socket, &SocketAddrUnix::new(door)?)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}
